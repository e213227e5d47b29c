"""One family of errors.

`InvalidInput` means that the input cannot be used: nothing was run and nothing was written.
"""


class DropoError(Exception):
    """Every error that dropo raises on purpose."""


class InvalidInput(DropoError, ValueError):
    """The input cannot be used. The command line answers with exit status 2."""


class BadArgument(InvalidInput):
    """An argument, a setting or an array breaks a rule that the message names."""


class BadFile(InvalidInput):
    """A file cannot be used: the message names the file, the key, what was expected and what was
    got.
    """

    def __init__(self, path: object, key: str, expected: str, got: object):
        where = f"{path}: {key}" if key else f"{path}"
        super().__init__(f"{where}: expected {expected}, got {got}.")
        self.path = path
        self.key = key


class BadEntry(BadFile):
    """An entry of a file that another part refused: its sentence, behind the file and the key."""

    def __init__(self, path: object, key: str, sentence: str):
        InvalidInput.__init__(self, f"{path}: {key}: {sentence}")
        self.path = path
        self.key = key


class UnknownName(InvalidInput, LookupError):
    """A name that nothing answers to; the message gives the nearest valid one."""


class Incompatible(InvalidInput):
    """Two parts that cannot work together; the message gives the reason and the way out."""


class MissingPackage(InvalidInput, ImportError):
    """A package is not installed that only some uses need; the message names it and the extra that
    brings it.
    """


class SimulationFailed(DropoError, RuntimeError):
    """The simulator diverged where it must not; the message says on which segments."""
