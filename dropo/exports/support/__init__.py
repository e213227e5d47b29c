"""What all targets share: the `Subject` that is exported, and the distribution of its parameters.

It imports `core`, `mjmodel`, `problems` and `simulators`, never a target. A new part is a file with
what more than one target needs; a target itself is a file beside this folder.
"""
