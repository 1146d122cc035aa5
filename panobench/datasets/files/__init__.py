"""Files that datasets are made of: images, times, tables, trajectories, archives."""
