"""Studies of `diagnose`: is the effect named that data hide, or by which a model is wrong?

May import `core`, `problems`, `diagnosis` (as `dropo.Diagnose`) and `studies.engine`.
To add a case of hidden effects, add it to `CASES` in `study.py` and to `hide_some`.
"""
