"""Whole runs with start states that are estimated: windows, linearization, noise levels.

They import `core` and `dropo.likelihoods.support` alone, and no likelihood by name.
A new part is a file with functions on windows and their columns; `dropo.likelihoods.trajectory`
puts them together.
"""
