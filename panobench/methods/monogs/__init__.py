"""Gaussian Splatting SLAM on pinhole images; see ``method.py``."""
