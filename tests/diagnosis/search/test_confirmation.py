"""What confirms an effect on windows held out."""

from types import SimpleNamespace

import numpy as np

from dropo.diagnosis.search.confirmation import is_confirmed


def test_what_acts_seldom_is_confirmed_where_no_window_loses():
    """Six windows of ninety-six that gain 80 nats each will do, as of a limit that is seldom
    reached; not four, nor with one that loses.
    """
    windows = SimpleNamespace(block=np.arange(96) % 26)

    def after(*gains):
        return SimpleNamespace(
            log_likelihood=np.concatenate([gains, np.zeros(96 - len(gains))]), windows=windows
        )

    assert is_confirmed(after(), after(*[80.0] * 6), 10.0)
    assert not is_confirmed(after(), after(*[80.0] * 6, -80.0), 10.0)
    assert not is_confirmed(after(), after(*[80.0] * 4), 10.0)
