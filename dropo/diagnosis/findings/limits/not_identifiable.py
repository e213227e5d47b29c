"""What of the fitted numbers the data do not determine."""

import numpy as np

from dropo.core.records.parameters import ParameterSpace
from dropo.diagnosis.search.linearization import Library
from dropo.diagnosis.search.trials import State
from dropo.evaluation.identifiability import describe_directions as sentences
from dropo.evaluation.identifiability import null_directions


def undetermined(library: Library, last: State) -> tuple[str, ...]:
    """Name fitted parameters and magnitudes, and combinations of them, that the data leave open.

    Parameters
    ----------
    library : Library
        The simulator with every effect.
    last : State
        Where the search ended.

    Returns
    -------
    tuple of str
        A sentence each.
    """
    if not len(last.free):
        return ()
    train = last.train
    parameters = list(library.simulator.space)
    own = ParameterSpace(tuple(parameters[i] for i in last.free))
    jacobian = train.flat(library.kept_jacobian(train.theta, last.free, train.windows))
    directions = null_directions(own, jacobian.T[:, None, :], np.ones(1))
    return tuple(sentences(own, train.theta[last.free], directions))
