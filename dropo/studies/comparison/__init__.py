"""Parts side by side: methods, likelihoods, optimizers and families on the same data sets.

May import `core`, `data`, `estimators`, `problems`, `simulators`, `studies.engine` and
`studies.tiboni_2021`, whose data sets it draws.
"""
