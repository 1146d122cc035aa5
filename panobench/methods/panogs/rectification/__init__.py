"""Frames as a global shutter with one centre of projection would have seen them."""
