"""What of the numbers that were fitted the data do not tell."""

import numpy as np

from dropo.core.records.parameters import ParameterSpace
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.selection import State
from dropo.evaluation.identifiability import null_directions
from dropo.evaluation.identifiability import undetermined as sentences


def undetermined(library: Library, last: State) -> tuple[str, ...]:
    """Declared parameters and sizes of causes, and combinations of them, that could as well be
    others, in words.
    """
    if not len(last.free):
        return ()
    linearized = last.train
    space = library.simulator.space
    own = ParameterSpace(tuple(list(space)[i] for i in last.free))
    slopes = linearized.flat(library.jacobian(linearized.theta, last.free, linearized.windows))
    return tuple(
        sentences(
            own, linearized.theta[last.free], null_directions(own, slopes.T[:, None, :], np.ones(1))
        )
    )
