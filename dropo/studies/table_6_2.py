"""Table 6.2."""

from dropo.studies.distribution_recovery import recovered
from dropo.studies.hopper_sets import FULL, Size
from dropo.studies.study import Study
from dropo.studies.work import Work


def table_6_2(work: Work, seeds: int | None = None, *, published: bool = False, size: Size = FULL) -> Study:
    """The spread of the torso's mass recovered from 1000 transitions, without and with noise (thesis, table 6.2)."""
    return recovered("table-6.2", "6.2", work, seeds, published, size)
