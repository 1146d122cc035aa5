"""Direct sparse odometry on the sphere; see ``method.py``."""
