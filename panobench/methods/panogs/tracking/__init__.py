"""Tracking: the pose of a frame against the map, and what to do when it is lost."""
