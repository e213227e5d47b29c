"""The benchmark of hidden effects: data sets by frozen seeds, answers to them, and their score.

`sets` makes the data sets, `answers` reads what somebody says is hidden in them, `score` counts
what is right, and `study` has dropo itself answer. May import `core`, `problems`, `diagnosis` (as
`dropo.Diagnose`), `studies.engine` and `studies.hidden_effects`. Another kind of effect or machine
is a line in `KINDS` or `MACHINES` of `sets.py`, and a new `VERSION`: its data sets are others.
"""
