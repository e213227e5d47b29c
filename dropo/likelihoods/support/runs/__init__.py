"""Whole runs with start states that are estimated: windows, linearization, noise levels.

Contents are found by name; nothing is exported here.
"""
