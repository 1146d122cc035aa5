"""What is done some frames behind the tracker: depth of new regions, and smoothing of poses."""
