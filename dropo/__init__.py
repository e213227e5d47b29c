"""Makes robot simulators honest: fits the distribution of their parameters, and names their faults.

The public names are listed once, in `__init__.pyi`; each is imported when it is first asked for,
so that `import dropo` and `dropo --help` load neither NumPy nor MuJoCo.
"""

import sys
from typing import Any

import lazy_loader

from dropo._version import __version__ as __version__

_import, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Import a public name; of a wrong one, Python's message names the nearest."""
    if name not in __all__:
        message = f"module 'dropo' has no attribute {name!r}"
        raise AttributeError(message, name=name, obj=sys.modules[__name__])
    return _import(name)
