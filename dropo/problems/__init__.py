"""Built-in problems and problem files: each function returns a `Problem` with its data.

May import all rooms below, of effects and evaluation what problem files and their checks need.
To add one, write `name(threads=0) -> Problem` in a file and register it under "problems".
"""
