"""Table 6.3: the masses of thigh, leg and foot vary."""

from collections.abc import Sequence

from dropo.studies.engine.study import Study
from dropo.studies.engine.variants import Variant
from dropo.studies.engine.work import Work
from dropo.studies.tiboni_2021.distribution_recovery import recovered
from dropo.studies.tiboni_2021.hopper_sets import FULL, HopperStudySize


def table_6_3(
    work: Work,
    seeds: int | None = None,
    *,
    published: bool = False,
    full: bool = False,
    variants: Sequence[Variant] = (),
    size: HopperStudySize = FULL,
) -> Study:
    """The spread of three masses from 1000 transitions, without and with noise (table 6.3).

    Parameters
    ----------
    work : Work
        Runs the fits.
    seeds : int or None
        Number of data sets; None for that of `size`.
    published : bool
        Whether the method is also run as published, at a reduced size.
    full : bool
        Whether it is run as published at full size, on the first data sets: many hours.
    variants : sequence of Variant
        Methods with parts exchanged, beside the others.
    size : HopperStudySize
        How large the study is.

    Returns
    -------
    Study
        Means, spreads and costs by method, without and with noise.
    """
    return recovered("table-6.3", "6.3", work, seeds, published, size, variants, full=full)
