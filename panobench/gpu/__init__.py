"""Computing on a GPU: CUDA C kernels, compiled at run time, and what launches them.

``source`` knows the kernels, ``nvrtc`` compiles them, ``device`` launches them; ``emulator`` runs them on a CPU, for
tests; ``checks`` says what is missing. Nothing here is imported unless a run is given a device.
"""
