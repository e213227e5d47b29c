"""Studies: what the methods find on many data sets, a folder for each paper or question.

May import every other room except `cli`; no room but `cli` imports this one.
To add one, write `study(work, seeds=None) -> Study` and register it under "studies".
"""
