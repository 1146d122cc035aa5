"""Inertial samples beside any visual trajectory: checks, initialisation, the visual-inertial fit, dead reckoning."""
