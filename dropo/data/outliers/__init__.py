"""Data that a model should not be fitted to: disturbed spans, outlier runs, a wrong input.

It may import `core` alone. A test more is a file with one function that takes a
simulator and trajectories, and returns a record that says in words what it found.
"""
