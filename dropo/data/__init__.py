"""Measured transitions: read from files, described, and checked; outliers in them.

It may import `core` and `mjmodel`. A new check is a function in `checks/` that yields `Finding`s,
called in `checks/check.py`; a new file format is a branch in `reading.py`.
"""
