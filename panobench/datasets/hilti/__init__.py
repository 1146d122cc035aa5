"""The Hilti x Trimble x Oxford 360 visual-inertial challenge of 2026: its recordings, made-up ones, and its masks.

Facts and figures: https://github.com/Hilti-Research/hilti-trimble-slam-challenge-2026.
"""
