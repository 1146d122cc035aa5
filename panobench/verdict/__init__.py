"""Is a run right? A verdict on every run from evidence that needs no ground truth."""
