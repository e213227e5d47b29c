"""Packages that only some uses need: where one is missing, the message says how to get it."""

from importlib.util import find_spec

from dropo.core.services.errors import MissingPackage


def need(*packages: str, extra: str, caller: str) -> None:
    """Raises MissingPackage unless all packages are installed; `extra` is the one that brings them."""
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        verb = "is" if len(missing) == 1 else "are"
        raise MissingPackage(
            f"{caller} needs {' and '.join(missing)}, which {verb} not installed: pip "
            f"install 'dropo[{extra}]'."
        )
