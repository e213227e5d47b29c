"""What every simulator must keep to."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.simulator import STEP, Simulator
from dropo.core.numerics.array_api import constant, is_tensor, plain
from dropo.core.records.trajectories import Segments
from dropo.core.services.errors import Incompatible
from dropo.core.services.validation import Array


def check_simulator(
    simulator: Simulator,
    segments: Segments,
    *,
    values: ArrayLike | None = None,
    diverging: ArrayLike | None = None,
    rtol: float = 1e-3,
) -> None:
    """Raises AssertionError, saying what is wrong, unless the simulator keeps to the contract on
    these segments.

    values: (K >= 3, d) parameter vectors under which no simulation fails; five of the box by
    default. diverging: (d,) one under which some do. rtol: how far sensitivities may be from
    differences, as a share of each one's largest over the rows.
    """
    unit = np.random.default_rng(0).uniform(0.2, 0.8, (5, len(simulator.space)))
    design = simulator.space.from_unit(unit) if values is None else np.array(values, dtype=float)
    predictions = _check_predictions(simulator, segments, design)
    _check_draws_apart(simulator, segments, design, predictions)
    _check_segments_apart(simulator, segments, design, predictions)
    _check_every_step(simulator, segments, design, predictions)
    _check_groups(simulator, segments, design)
    _check_offsets(simulator, segments, design, predictions)
    _check_sensitivities(simulator, segments, design[0], predictions[0], rtol)
    if simulator.has_gradients:
        _check_gradients(simulator, segments, design, predictions, rtol)
    if diverging is not None:
        _check_failures(
            simulator, segments, design, predictions, np.asarray(diverging, dtype=float)
        )


def _check_predictions(simulator: Simulator, segments: Segments, values: Array) -> Array:
    name = type(simulator).__name__
    before = simulator.steps
    given = values.copy()
    predictions = simulator.predict(values, segments)
    wanted = (len(values), len(segments.rows[0]), len(simulator.signals))
    assert predictions.shape == wanted, (
        f"{name}.predict gives shape {predictions.shape}, not {wanted}"
    )
    failed = ~np.isfinite(predictions).all(axis=(1, 2))
    assert not failed.any(), (
        f"simulations of {name} fail under {values[failed][:1]}: give `values` that it can simulate"
    )
    targets = simulator.targets(segments)
    assert targets.shape == wanted[1:], (
        f"{name}.targets gives shape {targets.shape}, not {wanted[1:]}"
    )
    cost = int(segments.lengths.sum()) * len(values) * simulator.steps_per_action
    assert simulator.steps - before == cost, (
        f"{name} counts {simulator.steps - before} steps instead of {cost}"
    )
    assert np.array_equal(given, values), f"{name}.predict changes the values it is given"
    again = simulator.predict(values, segments)
    assert np.array_equal(predictions, again), (
        f"{name}.predict is not deterministic: asked again, it gave {_gap(predictions, again)}"
    )
    assert not np.array_equal(predictions[0], predictions[1]), (
        f"{name}.predict does not depend on the parameters"
    )
    return predictions


def _check_draws_apart(
    simulator: Simulator, segments: Segments, values: Array, predictions: Array
) -> None:
    name = type(simulator).__name__
    apart = np.concatenate(
        [simulator.predict(values[:1], segments), simulator.predict(values[1:], segments)]
    )
    assert np.array_equal(predictions, apart), (
        f"{name}.predict depends on how the draws are split: {_gap(predictions, apart)}"
    )
    turned = simulator.predict(values[::-1], segments)[::-1]
    assert np.array_equal(predictions, turned), (
        f"{name}.predict depends on the order of the draws: {_gap(predictions, turned)}"
    )


def _check_segments_apart(
    simulator: Simulator, segments: Segments, values: Array, predictions: Array
) -> None:
    cut = _middle(segments)
    if cut:
        parts = [segments.take(np.arange(cut)), segments.take(np.arange(cut, len(segments)))]
        apart = np.concatenate([simulator.predict(values, part) for part in parts], axis=1)
        same = np.array_equal(predictions, apart)
        assert same, (
            f"{type(simulator).__name__}.predict depends on which segments come together: "
            f"{_gap(predictions, apart)}"
        )


def _check_every_step(
    simulator: Simulator, segments: Segments, values: Array, predictions: Array
) -> None:
    every = segments.comparing_every_step()
    dense = simulator.predict(values, every)
    segment, step = every.rows
    assert dense.shape[1] == len(segment), (
        f"{type(simulator).__name__}.predict gives {dense.shape[1]} of the {len(segment)} "
        "compared steps"
    )
    mine = np.isin(
        segment * (step.max() + 1) + step, segments.rows[0] * (step.max() + 1) + segments.rows[1]
    )
    same = np.array_equal(dense[:, mine], predictions)
    assert same, (
        f"{type(simulator).__name__}.predict gives other numbers where every step is "
        f"compared: {_gap(predictions, dense[:, mine])}"
    )


def _check_groups(simulator: Simulator, segments: Segments, values: Array) -> None:
    group = segments.group
    if (group[segments.previous] != group)[segments.previous >= 0].any():
        return  # a chain across groups cannot be taken apart
    count = int(group.max()) + 1
    by_group = values[(np.arange(2)[:, None] + np.arange(count)) % len(values)]  # (2, G, d)
    together = simulator.predict(by_group, segments)
    row_group = group[segments.rows[0]]
    for g in np.unique(group):
        alone = simulator.predict(by_group[:, g], segments.take(group == g))
        same = np.array_equal(together[:, row_group == g], alone)
        gap = _gap(together[:, row_group == g], alone)
        assert same, (
            f"{type(simulator).__name__}.predict with values by group is wrong in group {g}: {gap}"
        )


def _check_offsets(
    simulator: Simulator, segments: Segments, values: Array, predictions: Array
) -> None:
    try:
        same = simulator.predict(
            values, segments, offsets=np.zeros((len(values), len(segments), simulator.start_size))
        )
    except Incompatible:
        return
    near = np.allclose(same, predictions, rtol=1e-9, atol=1e-12)
    assert near, (
        f"{type(simulator).__name__}.predict changes under start offsets of zero: "
        f"{_gap(predictions, same)}"
    )


def _check_sensitivities(
    simulator: Simulator, segments: Segments, centre: Array, prediction: Array, rtol: float
) -> None:
    name = type(simulator).__name__
    width = simulator.space.high - simulator.space.low
    value, slopes = simulator.linearize(centre, segments)
    wanted = (*prediction.shape, len(centre))
    assert slopes.shape == wanted, (
        f"{name}.linearize gives sensitivities of shape {slopes.shape}, not {wanted}"
    )
    near = np.allclose(value, prediction, rtol=1e-9, atol=1e-12)
    assert near, (
        f"{name}.linearize gives another prediction than predict: {_gap(prediction, value)}"
    )
    assert np.allclose(slopes, simulator.sensitivities(centre, segments), rtol=1e-9), (
        f"{name}.sensitivities and linearize differ"
    )
    half = np.diag(
        3 * STEP * width
    )  # not the step of the base class, so that agreement means something
    ahead = simulator.predict(centre + half, segments)
    behind = simulator.predict(centre - half, segments)
    differences = np.moveaxis(
        (ahead - behind) / (6 * STEP * width)[:, None, None], 0, -1
    )  # (R, p, d)
    rounding = 1e-8 * np.abs(prediction).max(axis=0)[:, None] / width
    off = np.abs(slopes - differences) > rtol * np.abs(differences).max(axis=0) + rounding
    if off.any():
        row, signal, i = (int(index[0]) for index in np.nonzero(off))
        where = f"d {simulator.signals[signal].name} / d {simulator.space.names[i]} at row {row}"
        raise AssertionError(
            f"{name}: {where} is {slopes[row, signal, i]:.6g}, differences give "
            f"{differences[row, signal, i]:.6g}"
        )


def _check_gradients(
    simulator: Simulator, segments: Segments, values: Array, predictions: Array, rtol: float
) -> None:
    import torch

    name = type(simulator).__name__
    leaf = torch.tensor(values, requires_grad=True)
    given: Any = leaf
    found: Any = simulator.predict(given, segments)
    keeps = is_tensor(found) and found.requires_grad
    assert keeps, (
        f"{name} has gradients, but of a tensor its predict gives no tensor with a history"
    )
    near = np.allclose(plain(found), predictions, rtol=1e-10, atol=1e-12)
    assert near, (
        f"{name}.predict gives other numbers for a tensor than for an array: "
        f"{_gap(predictions, plain(found))}"
    )
    weights = np.random.default_rng(1).standard_normal(predictions.shape)
    slopes = plain(torch.autograd.grad((found * constant(weights, found)).sum(), leaf)[0])
    exact = simulator.sensitivities(values[0], segments)
    expected, size = (
        np.einsum("rp,rpd->d", w, s)
        for w, s in ((weights[0], exact), (np.abs(weights[0]), np.abs(exact)))
    )
    i = int(np.argmax(np.abs(slopes[0] - expected) / (size + 1e-300)))
    where = f"of a weighted sum of predictions by {simulator.space.names[i]}"
    same = abs(slopes[0, i] - expected[i]) <= rtol * size[i]
    assert same, (
        f"{name}: the gradient {where} is {slopes[0, i]:.6g}, its sensitivities give "
        f"{expected[i]:.6g}"
    )


def _check_failures(
    simulator: Simulator, segments: Segments, values: Array, predictions: Array, diverging: Array
) -> None:
    name = type(simulator).__name__
    before = simulator.failures
    mixed = simulator.predict(np.stack([values[0], diverging, values[1]]), segments)
    assert np.isnan(mixed[1]).any(), (
        f"no simulation of {name} failed under the diverging parameters"
    )
    others = mixed[[0, 2]]
    assert np.array_equal(others, predictions[:2]), (
        f"a failed simulation of {name} changes the others: {_gap(predictions[:2], others)}"
    )
    assert simulator.failures > before, f"{name} does not count its failures"


def _middle(segments: Segments) -> int:
    """The segment nearest to the middle before which a chain can be cut; 0 where there is none."""
    crossed = np.zeros(len(segments) + 1, dtype=int)
    linked = np.flatnonzero(segments.previous >= 0)
    np.add.at(crossed, segments.previous[linked] + 1, 1)
    np.add.at(crossed, linked + 1, -1)
    cuts = [i for i in np.flatnonzero(np.cumsum(crossed)[:-1] == 0).tolist() if i > 0]
    return min(cuts, key=lambda i: abs(i - len(segments) / 2), default=0)


def _gap(one: Array, other: Array) -> str:
    if one.shape != other.shape:
        return f"shapes {one.shape} and {other.shape}"
    return f"a largest difference of {np.nanmax(np.abs(one - other)):.3g}"
