"""Packages that only some uses need: where one is missing, the message says how to get it."""

from importlib.util import find_spec

from dropo.core.services.errors import MissingPackage


def need(*packages: str, extra: str, caller: str) -> None:
    """Refuse to go on unless packages are installed.

    Parameters
    ----------
    *packages : str
        Their import names.
    extra : str
        The extra of dropo that installs them.
    caller : str
        What needs them, for the message.

    Raises
    ------
    MissingPackage
        If one is missing; the message says how to install it.
    """
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        verb = "is" if len(missing) == 1 else "are"
        raise MissingPackage(
            f"{caller} needs {' and '.join(missing)}, which {verb} not installed: pip "
            f"install 'dropo[{extra}]'."
        )
