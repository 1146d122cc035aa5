"""Feature tracking with a Gaussian map; see ``method.py``."""
