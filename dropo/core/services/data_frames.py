"""Results as pandas tables, where pandas is installed."""

from collections.abc import Sequence
from typing import Any

from dropo.core.services.optional_dependencies import need


def frame(rows: Sequence[dict[str, Any]], index: str) -> Any:
    """A pandas.DataFrame of rows of equal keys, indexed by one of these.

    Needs the extra `tables`.
    """
    need("pandas", extra="tables", caller="A table for pandas")
    import pandas

    return pandas.DataFrame(list(rows)).set_index(index) if rows else pandas.DataFrame()
