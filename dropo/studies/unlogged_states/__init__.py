"""Fits of logs whose states are noisy or only partly measured, against the Cramer-Rao bound.

`machines` simulates the logs and computes the bound, `study` fits them. May import `core`,
`mjmodel`, `simulators`, `problems`, `estimators` and `studies.engine`. To add a kind of log, add
its noise to `NOISES` or its machine to `MACHINES` of `machines.py`.
"""
