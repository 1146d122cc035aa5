"""Rigs of several lenses: their frames as one picture, and their scale."""
