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
    """A file cannot be used.

    The message names the file, the key, what was expected and what was got.

    Parameters
    ----------
    path : str or Path
        The file.
    key : str
        The entry's keys from the top of the file, joined by dots; empty for the whole file.
    expected, got : str
        What had to stand there, and what stands there.
    hint : str
        A sentence that says what else to do, else "".
    """

    def __init__(self, path: object, key: str, expected: str, got: object, hint: str = ""):
        where = f"{path}: {key}" if key else f"{path}"
        super().__init__(f"{where}: expected {expected}, got {got}. {hint}".rstrip())
        self.path = path
        self.key = key


class BadEntry(BadFile):
    """An entry of a file that another part refused.

    Parameters
    ----------
    path : str or Path
        The file.
    key : str
        The entry's keys from the top of the file, joined by dots.
    sentence : str
        The message of that part.
    """

    def __init__(self, path: object, key: str, sentence: str):
        InvalidInput.__init__(self, f"{path}: {key}: {sentence}")
        self.path = path
        self.key = key


class UnknownName(InvalidInput, LookupError):
    """A name that does not exist; the message gives the nearest valid one."""


class Incompatible(InvalidInput):
    """Two parts that cannot work together; the message gives the reason and the way out."""


class MissingPackage(InvalidInput, ImportError):
    """A package that only some uses need is missing; the message says how to install it."""


class SimulationFailed(DropoError, RuntimeError):
    """The simulator diverged where it must not; the message says in which rows."""
