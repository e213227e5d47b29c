"""The study of the problems on measured data: what is diagnosed, and what it gains.

May import `core`, `problems`, `diagnosis` and `studies.engine`.
To add a problem, add its unit and horizon to `EVALUATED` in `study.py`.
"""
