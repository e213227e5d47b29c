"""Numerical methods of textbooks: functions from arrays to arrays.

They import services alone. Add a method in a file of its own, with shapes in its docstring, the
source of its formula, and a test against an answer that is known.
"""
