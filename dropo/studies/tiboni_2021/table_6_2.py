"""Table 6.2."""

from dropo.studies.engine.study import Study
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021.distribution_recovery import recovered
from dropo.studies.tiboni_2021.hopper_sets import FULL, Size


def table_6_2(
    work: Work, seeds: int | None = None, *, published: bool = False, size: Size = FULL
) -> Study:
    """The spread of the torso's mass recovered from 1000 transitions, without and with noise
    (thesis, table 6.2).
    """
    return recovered("table-6.2", "6.2", work, seeds, published, size)
