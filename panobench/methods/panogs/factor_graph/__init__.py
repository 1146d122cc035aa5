"""The whole trajectory: bundle-adjustment factors, and loop factors where the camera comes back."""
