"""Estimators: the methods that `--method` names, one a file; `support` holds what they share.

They import `core`, `mjmodel` and `evaluation`, and find likelihoods, families and optimizers by
name. A new one is a subclass of `core.contracts.estimator.Estimator` that the registry knows by
name.
"""
