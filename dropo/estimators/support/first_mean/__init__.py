"""Where a search begins: the best of a wide box, the best of several optima, and what blows up.

They import `core` and `dropo.estimators.support`, and no method.
A new part is a file with functions of a problem and a run that give a first mean or improve one.
"""
