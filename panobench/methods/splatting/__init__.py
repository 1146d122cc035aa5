"""Fitting a Gaussian map to posed images: what the methods that map with Gaussians share."""
