"""What everything stands on: four floors, services, numerics, records and contracts.

The package gives the contracts, each imported when it is first asked for, so that
`from dropo.core import Simulator` is all that a plug-in needs; `__init__.pyi` lists them. It
imports nothing of dropo outside itself but the version. Add a module to the lowest floor that has
all it needs, and a contract's name to `__init__.pyi`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
