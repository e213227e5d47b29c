"""Studies of `diagnose`: whether the effect is named that data hide, or a model lacks.

May import `core`, `problems`, `diagnosis` (as `dropo.Diagnose`) and `studies.engine`.
To add a case of hidden effects, add it to `CASES` in `study.py` and to `hide_some`.
"""
