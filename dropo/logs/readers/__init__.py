"""Readers of raw logs, one file for each family of formats.

They may import `core` alone. A new one is a subclass of `reader.Log` with `columns` and `read`, and
a line in `reader.py` for its ending.
"""
