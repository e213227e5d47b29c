"""Results as pandas tables, where pandas is installed."""

from collections.abc import Sequence
from typing import Any

from dropo.core.services.optional_dependencies import need


def frame(rows: Sequence[dict[str, Any]], index: str) -> Any:
    """Make a pandas.DataFrame of rows with the same keys.

    Parameters
    ----------
    rows : sequence of dict
        The rows.
    index : str
        The key that is the index.

    Returns
    -------
    pandas.DataFrame
        Empty if there are no rows.

    Raises
    ------
    MissingPackage
        If pandas is not installed (extra `tables`).
    """
    need("pandas", extra="tables", caller="A table for pandas")
    import pandas as pd

    return pd.DataFrame(list(rows)).set_index(index) if rows else pd.DataFrame()
