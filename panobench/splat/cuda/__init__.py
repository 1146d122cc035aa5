"""Maps on a GPU: the counterparts of the Numba renderer and optimiser, whose arrays stay on a device.

The kernels are in ``gpu/kernels``. Nothing here is imported unless a run is given a device.
"""
