"""What a real recording adds to a clean one: who carries the camera, who walks by, the lenses, shutter and codec."""
