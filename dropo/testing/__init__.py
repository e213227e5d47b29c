"""The contracts as checks for authors of plug-ins: each raises AssertionError or is silent.

Beside these, statistical tests of estimators and samplers: coverage and calibration.

The room imports `core` and the contract of a log's reader; a message says which rule is broken, and
by how much.
To add a check, write a module named after the contract and list its `check_...` function here.
"""

from dropo.testing.effects import check_effect as check_effect
from dropo.testing.estimators import check_estimator as check_estimator
from dropo.testing.families import check_family as check_family
from dropo.testing.likelihoods import check_likelihood as check_likelihood
from dropo.testing.log_readers import check_log_reader as check_log_reader
from dropo.testing.optimizers import check_optimizer as check_optimizer
from dropo.testing.samplers import check_sampler as check_sampler
from dropo.testing.simulators import check_simulator as check_simulator
from dropo.testing.statistics import coverage as coverage
from dropo.testing.statistics import expected_coverage as expected_coverage
from dropo.testing.statistics import (
    simulation_based_calibration as simulation_based_calibration,
)
