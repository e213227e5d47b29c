"""Warnings of runs that go on, beside those that stand in a result."""


class DropoWarning(RuntimeWarning):
    """What a run that goes on wants known; the command line prints it in one line."""
