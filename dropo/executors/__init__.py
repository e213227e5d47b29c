"""Executors by name: processes of this machine, Dask, Ray and SLURM; workers that die are replaced.

Each is a function that takes what stands behind its name's colon and gives a context manager of a
`concurrent.futures.Executor`. What runs on it gives the same numbers, bit for bit.
They import `core` alone; packages of clusters are imported where they are used.
To add one, write such a function, a `contextlib.contextmanager` that closes what it opened, name it
in `dropo.core.services.registry` and raise `DropoError` where its cluster does not answer.
"""
