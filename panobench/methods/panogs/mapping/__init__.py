"""The map: keyframes, new Gaussians, training steps, and what must not stay in it."""
