"""Feature SLAM on bearing vectors, for any central camera; see ``method.py``."""
