"""Sequences seen by other cameras, and written in panobench's own format."""
