"""Likelihoods, one a file, named as on the command line; `support` holds what they share.

They import `core` alone: no estimator, no family and no simulator by name.
A new one is a `SampledLikelihood` (write `_log_density`) or a `LocalLikelihood` in the registry.
"""
