"""The ground floor: errors, checks of input, names of plug-ins, tables of text; `files/`.

It imports nothing of dropo but this floor. Add a module here if it knows nothing of parameters,
trajectories or fits, and two rooms or more need it.
"""
