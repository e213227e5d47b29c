"""Built-in problems and problem files: each function returns a `Problem` with its data.

May import `core`, `mjmodel`, `simulators`, `data` and `logs`; nothing here is imported by them.
To add one, write `name(threads=0) -> Problem` in a file and register it under "problems".
"""
