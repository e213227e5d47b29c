"""Fits of many hours, whose evaluations are kept in a study's journal one batch after the other."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from dropo.core.contracts.estimator import Estimator
from dropo.core.contracts.problem import Problem
from dropo.core.records.fits.fit import Fit, Status
from dropo.core.services.files.evaluation_log import Answer, EvaluationLog
from dropo.core.services.validation import Array
from dropo.studies.engine.work import Work


class _Stopped(BaseException):
    """An interruption within an evaluation; an estimator takes it for no end of its search, whose
    best would be summarized first.
    """


class KeptEvaluations(EvaluationLog):
    """The evaluations of one fit, kept among the answers of a study.

    Parameters
    ----------
    work : Work
        Keeps them.
    key : str
        What identifies the fit.

    Attributes
    ----------
    seconds : float
        Processor time of all evaluations, those of earlier runs too [s].
    """

    def __init__(self, work: Work, key: str):
        super().__init__()
        self.work = work
        self.key = key
        self.batches = 0
        self.seconds = 0.0

    def evaluate(self, points: Array, function: Callable[[Array], Answer]) -> Answer:
        """Evaluate a batch, or read its values if an earlier run has made them.

        Parameters
        ----------
        points : (P, m) array
            Where.
        function : callable
            Points to values and costs.

        Returns
        -------
        answers : array
            The values, float64.
        counts : dict of str to int
            What the batch cost, by kind.

        Raises
        ------
        KeyboardInterrupt
            If the evaluation is interrupted; what earlier ones gave is kept.
        """

        def make() -> dict[str, Any]:
            begun = time.process_time()
            try:
                answers, counts = function(points)
            except KeyboardInterrupt:
                raise _Stopped from None
            seconds = time.process_time() - begun
            return {"answers": answers.tolist(), "counts": counts, "seconds": seconds}

        self.batches += 1
        kept = self.work.kept(f"{self.key}, batch {self.batches}", make)
        self.seconds += kept["seconds"]
        return np.array(kept["answers"], dtype=float), dict(kept["counts"])


def long_fit(work: Work, key: str, estimator: Estimator, problem: Problem) -> Fit:
    """Fit a problem, and go on where an earlier run of the study was interrupted.

    Parameters
    ----------
    work : Work
        Keeps the evaluations.
    key : str
        What identifies the fit among all of the study: all of its settings and data.
    estimator : Estimator
        Its evaluations are the same in every run, bit for bit.
    problem : Problem
        What it fits.

    Returns
    -------
    Fit
        Its `wall_time_s` is the processor time of all its evaluations, in whatever runs.

    Raises
    ------
    KeyboardInterrupt
        If the search was interrupted: its best so far is no answer of a study.
    """
    log = KeptEvaluations(work, key)
    try:
        fit = estimator.fit(problem, rng=0, evaluation_log=log, progress=work.progress)
    except _Stopped:
        raise KeyboardInterrupt from None
    if fit.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return replace(fit, wall_time_s=log.seconds)
