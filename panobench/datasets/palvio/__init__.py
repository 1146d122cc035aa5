"""PALVIO: panoramic annular images and an IMU; its calibration, and bags made like its own."""
