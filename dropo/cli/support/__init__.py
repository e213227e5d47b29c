"""What commands share: what they print, the folder and the record of a run, and other machines.

They import `core`, `problems.record` and, inside functions, `executors`. Add a module here if two
commands need it.
"""
