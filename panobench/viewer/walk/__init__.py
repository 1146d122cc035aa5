"""A map to walk through: one offline HTML page with its Gaussians, its path, and a renderer in WebGL."""
