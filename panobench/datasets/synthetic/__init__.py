"""Sequences that are made: built-in rooms, walks through them, and disturbances of any stream."""
