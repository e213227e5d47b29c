"""The search for causes: windows, linearization, screening, refit, selection, review.

It may import `core`, `mjmodel` and `evaluation`. A step more is a file with one settings object,
called by `selection` or `review`.
"""
