"""What compiled kernels share: Numba's options, fast elementary functions, and how arrays are laid out.

Nothing here imports another package of panobench, so that the renderer (``splat``) and direct alignment
(``photometric``) can both build on it without knowing each other.
"""
