"""The study of DROPO and the related methods on the hopper: errors, costs, returns of policies.

May import `core`, `estimators`, `families`, `problems`, `training` and the other studies.
To add a method, name it in `METHODS` of `fits.py` and build it in `estimator`.
"""
