"""The start: frames wait until the depth of one of them is known."""
