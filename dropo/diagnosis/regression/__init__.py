"""Inverse dynamics as a regression: all that acts linearly on the joints' forces, in one solve.

No simulation is run here. What it finds is where a search by simulation starts: `equation` makes
rows of a log, `terms` lists what may be missing, `fit` and `choice` decide what is, and `quick` is
the diagnosis made of them. It may import `core`, `mjmodel`, `diagnosis.parts`, `diagnosis.search`
and, for how commands act, `simulators.mujoco`. Another missing number is a `Term` of `terms`.
"""
