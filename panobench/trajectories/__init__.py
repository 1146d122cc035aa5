"""Trajectories in the formats that programs write, and how their poses find the frames they belong to."""
