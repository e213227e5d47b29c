"""Numbers as tables show them."""

import pytest

from dropo.core.services.tables import Table, estimate


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.30192884, 0.00077, "0.30193"),
        (0.15, 3.8e-5, "0.150000"),
        (3.5342917463, 3.3e-10, "3.53429174630"),
        (1234.5, 21.0, "1234"),
        (-2.0, 0.1, "-2.00"),
        (1.23456789, float("nan"), "1.234568"),
        (1.23456789, 0.0, "1.234568"),
        (2e-9, 1e-10, "2e-09"),
        (float("nan"), 0.1, "-"),
        (1.0, 1e-20, "1.00000000000000"),
    ],
)
def test_an_estimate_has_the_decimals_of_its_error(value, error, text):
    """Two digits of the standard error decide; without one, seven digits."""
    assert estimate(value, error) == text


def test_a_table_for_a_paper() -> None:
    """LaTeX with its commands escaped, Markdown with its bars, pandas with columns of one title."""
    table = Table("50 % of_all", ("what", "p", "p"), (("a|b", "1", "2"), ("~{x}", "3", "4")))
    assert table.to_latex() == (
        "\\begin{table}\n\\caption{50 \\% of\\_all}\n\\begin{tabular}{lrr}\n\\toprule\n"
        "what & p & p \\\\\n\\midrule\na|b & 1 & 2 \\\\\n"
        "\\textasciitilde{}\\{x\\} & 3 & 4 \\\\\n\\bottomrule\n\\end{tabular}\n\\end{table}\n"
    )
    assert table.to_markdown() == (
        "**50 % of_all**\n\n| what | p | p |\n|---|---:|---:|\n"
        "| a\\|b | 1 | 2 |\n| ~{x} | 3 | 4 |\n"
    )
    frame = table.to_pandas()
    assert list(frame.columns) == ["p", "p"]
    assert frame.iloc[1].tolist() == ["3", "4"]
    assert frame.index.tolist() == ["a|b", "~{x}"]
