"""Studies of uncertainty: coverage of confidence intervals, calibration of posteriors.

May import `core`, `estimators`, `problems`, `simulators` and `studies.engine`.
To add a case, add it to `CASES` of the study.
"""
