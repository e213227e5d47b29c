"""MuJoCo Warp, for GPUs: worlds in single precision side by side.

It imports `core`, `mjmodel` and the simulator of MuJoCo on the CPU, whose model and columns it
takes; the package itself is imported where it is used.
"""
