"""The study `laws`: laws that no effect stands for, hidden in simulated data and looked for.

May import `core`, `effects`, `problems`, `diagnosis` (as `dropo.Diagnose`) and `studies.engine`. To
add a law, add its formula to `EVALUATION` in `study.py`.
"""
