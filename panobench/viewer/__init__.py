"""Watching a run while it goes on: viewers are plugins on the lifecycle hooks, registered only when asked for."""
