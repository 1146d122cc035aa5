"""Figures for papers, drawn by matplotlib from the runs and studies of a report."""
