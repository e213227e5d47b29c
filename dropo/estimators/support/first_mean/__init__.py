"""Where a search begins: the best of a wide box, the best of several optima.

Import from the module that has what you need; the package itself has nothing.
"""
