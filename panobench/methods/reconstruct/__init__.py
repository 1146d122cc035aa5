"""Offline Gaussian reconstruction with given poses; see ``method.py``."""
