"""Camera-agnostic feature SLAM on bearing vectors; see ``method.py``."""
