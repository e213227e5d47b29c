"""Checks that every simulator must pass."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dropo.core.contracts.simulator import Simulator
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
    """Check that a simulator keeps to the contract of `Simulator` on some segments.

    Parameters
    ----------
    simulator : Simulator
        The simulator.
    segments : Segments
        Segments of its data.
    values : (K, d) array, optional
        At least three parameter vectors under which no simulation fails; five of the search box by
        default.
    diverging : (d,) array, optional
        A parameter vector under which some simulations fail.
    rtol : float
        Largest difference of sensitivities from finite differences, as a fraction of each
        parameter's largest one over the rows.

    Raises
    ------
    AssertionError
        If a rule is broken; the message says which.
    """
    unit = np.random.default_rng(0).uniform(0.2, 0.8, (5, len(simulator.space)))
    design = simulator.space.from_unit(unit) if values is None else np.array(values, dtype=float)
    predictions = _check_predictions(simulator, segments, design)
    _check_split_draws(simulator, segments, design, predictions)
    _check_split_segments(simulator, segments, design, predictions)
    _check_every_step(simulator, segments, design, predictions)
    _check_groups(simulator, segments, design)
    _check_offsets(simulator, segments, design, predictions)
    _check_ends(simulator, segments, design)
    _check_jacobian(simulator, segments, design[0], predictions[0], rtol)
    if simulator.has_gradients:
        _check_gradients(simulator, segments, design, predictions, rtol)
    if diverging is not None:
        _check_failures(
            simulator, segments, design, predictions, np.asarray(diverging, dtype=float)
        )


def _check_predictions(simulator: Simulator, segments: Segments, values: Array) -> Array:
    """Predictions are finite, deterministic and counted, and depend on the parameters."""
    name = type(simulator).__name__
    before = simulator.steps
    original = values.copy()
    predictions = simulator.predict(values, segments)
    expected = (len(values), len(segments.rows[0]), len(simulator.signals))
    assert predictions.shape == expected, (
        f"{name}.predict gives shape {predictions.shape}, not {expected}"
    )
    failed = ~np.isfinite(predictions).all(axis=(1, 2))
    assert not failed.any(), (
        f"simulations of {name} fail under {values[failed][:1]}: give `values` that it can simulate"
    )
    targets = simulator.targets(segments)
    assert targets.shape == expected[1:], (
        f"{name}.targets gives shape {targets.shape}, not {expected[1:]}"
    )
    cost = int(segments.lengths.sum()) * len(values) * simulator.steps_per_action
    assert simulator.steps - before == cost, (
        f"{name} counts {simulator.steps - before} steps instead of {cost}"
    )
    assert np.array_equal(original, values), f"{name}.predict changes the values it is given"
    again = simulator.predict(values, segments)
    assert np.array_equal(predictions, again), (
        f"{name}.predict is not deterministic: asked again, it gave {_gap(predictions, again)}"
    )
    assert not np.array_equal(predictions[0], predictions[1]), (
        f"{name}.predict does not depend on the parameters"
    )
    return predictions


def _check_split_draws(
    simulator: Simulator, segments: Segments, values: Array, predictions: Array
) -> None:
    """A draw's prediction does not depend on the other draws of the batch, nor on their order."""
    name = type(simulator).__name__
    split = np.concatenate(
        [simulator.predict(values[:1], segments), simulator.predict(values[1:], segments)]
    )
    assert np.array_equal(predictions, split), (
        f"{name}.predict depends on how the draws are split: {_gap(predictions, split)}"
    )
    reordered = simulator.predict(values[::-1], segments)[::-1]
    assert np.array_equal(predictions, reordered), (
        f"{name}.predict depends on the order of the draws: {_gap(predictions, reordered)}"
    )


def _check_split_segments(
    simulator: Simulator, segments: Segments, values: Array, predictions: Array
) -> None:
    """A segment's prediction does not depend on the other segments of the batch."""
    cut = _middle(segments)
    if not cut:
        return
    parts = [segments.take(np.arange(cut)), segments.take(np.arange(cut, len(segments)))]
    split = np.concatenate([simulator.predict(values, part) for part in parts], axis=1)
    assert np.array_equal(predictions, split), (
        f"{type(simulator).__name__}.predict depends on which segments come together: "
        f"{_gap(predictions, split)}"
    )


def _check_every_step(
    simulator: Simulator, segments: Segments, values: Array, predictions: Array
) -> None:
    """Comparing every step adds rows, and changes none."""
    name = type(simulator).__name__
    every = segments.comparing_every_step()
    dense = simulator.predict(values, every)
    segment, step = every.rows
    assert dense.shape[1] == len(segment), (
        f"{name}.predict gives {dense.shape[1]} of the {len(segment)} compared steps"
    )
    # the rows of `every` that `segments` has too, found by one number a row
    stride = step.max() + 1
    own_segment, own_step = segments.rows
    own = dense[:, np.isin(segment * stride + step, own_segment * stride + own_step)]
    assert np.array_equal(own, predictions), (
        f"{name}.predict gives other numbers where every step is compared: {_gap(predictions, own)}"
    )


def _check_groups(simulator: Simulator, segments: Segments, values: Array) -> None:
    """Values by group are those of each group by itself."""
    group = segments.group
    if (group[segments.previous] != group)[segments.previous >= 0].any():
        return  # a chain across groups cannot be taken apart
    count = int(group.max()) + 1
    by_group = values[(np.arange(2)[:, None] + np.arange(count)) % len(values)]  # (2, G, d)
    together = simulator.predict(by_group, segments)
    row_group = group[segments.rows[0]]
    for g in np.unique(group):
        expected = simulator.predict(by_group[:, g], segments.take(group == g))
        found = together[:, row_group == g]
        assert np.array_equal(found, expected), (
            f"{type(simulator).__name__}.predict with values by group is wrong in group {g}: "
            f"{_gap(found, expected)}"
        )


def _check_offsets(
    simulator: Simulator, segments: Segments, values: Array, predictions: Array
) -> None:
    """Start offsets of zero change nothing, where the simulator takes offsets."""
    offsets = np.zeros((len(values), len(segments), simulator.start_size))
    try:
        found = simulator.predict(values, segments, offsets=offsets)
    except Incompatible:
        return
    assert np.allclose(found, predictions, rtol=1e-9, atol=1e-12), (
        f"{type(simulator).__name__}.predict changes under start offsets of zero: "
        f"{_gap(predictions, found)}"
    )


def _check_ends(simulator: Simulator, segments: Segments, values: Array) -> None:
    """A segment that starts where another one ended goes on as if they were one."""
    name = type(simulator).__name__
    whole, columns = simulator.observing_state()
    coordinates = whole.state_coordinates
    assert coordinates.shape == (whole.start_size,), (
        f"{name}.state_coordinates has shape {coordinates.shape}, not {(whole.start_size,)}"
    )
    data = segments.trajectories
    spans = [(start, stop) for start, stop in data.spans if stop - start >= 2]
    if segments.levels[1:] or not spans:
        return
    further = np.broadcast_to(columns, (len(data), len(columns)))
    data = replace(
        data,
        observations=np.concatenate([data.observations, further], axis=1),
        next_observations=np.concatenate([data.next_observations, further], axis=1),
    )
    first = np.array([start for start, _ in spans])
    halves = [data.from_rows(first), data.from_rows(first + 1)]
    try:
        _, ends = whole.predict_with_ends(values, halves[0])
        expected = (len(values), len(first), whole.start_size)
        assert ends.shape == expected, (
            f"{name}.predict_with_ends gives ends of shape {ends.shape}, not {expected}"
        )
        # An end is given from the measurement there; the next row begins with its own.
        follows = (data.next_observations[first] == data.observations[first + 1]).all(axis=1)
        apart = np.where(coordinates, ends, 0.0)
        found = whole.predict(values, halves[1], offsets=apart)[:, follows]
    except Incompatible:
        return
    together = whole.predict(values, data.from_rows(first, 2))[:, follows]
    size = np.abs(together).max(axis=(0, 1), initial=1e-12)
    assert np.all(np.abs(found - together) <= 1e-6 * size), (
        f"{name}: a segment that starts where another one ended goes on otherwise: "
        f"{_gap(together, found)}"
    )


def _check_jacobian(
    simulator: Simulator, segments: Segments, centre: Array, prediction: Array, rtol: float
) -> None:
    """Sensitivities agree with finite differences at `centre` (d,), up to `rtol`."""
    name = type(simulator).__name__
    width = simulator.space.high - simulator.space.low
    value, sensitivities = simulator.linearize(centre, segments)
    expected = (*prediction.shape, len(centre))
    assert sensitivities.shape == expected, (
        f"{name}.linearize gives sensitivities of shape {sensitivities.shape}, not {expected}"
    )
    assert np.allclose(value, prediction, rtol=1e-9, atol=1e-12), (
        f"{name}.linearize gives another prediction than predict: {_gap(prediction, value)}"
    )
    assert np.allclose(sensitivities, simulator.jacobian(centre, segments), rtol=1e-9), (
        f"{name}.jacobian and linearize differ"
    )
    # not the step of the base class, so that agreement means something
    step = 3 * simulator.minimum_step * width
    ahead = simulator.predict(centre + np.diag(step), segments)
    behind = simulator.predict(centre - np.diag(step), segments)
    quotients = (ahead - behind) / (2 * step)[:, None, None]
    differences = np.moveaxis(quotients, 0, -1)  # (R, p, d)
    relative = max(1e-8, 10 * simulator.minimum_step**2)  # of quotients over the least step
    rounding = relative * np.abs(prediction).max(axis=0)[:, None] / width
    tolerance = rtol * np.abs(differences).max(axis=0) + rounding
    wrong = np.abs(sensitivities - differences) > tolerance
    if wrong.any():
        row, signal, i = np.argwhere(wrong)[0].tolist()
        where = f"d {simulator.signals[signal].name} / d {simulator.space.names[i]} at row {row}"
        raise AssertionError(
            f"{name}: {where} is {sensitivities[row, signal, i]:.6g}, differences give "
            f"{differences[row, signal, i]:.6g}"
        )


def _check_gradients(
    simulator: Simulator, segments: Segments, values: Array, predictions: Array, rtol: float
) -> None:
    """Tensors give the same predictions as arrays, with the gradient of the sensitivities."""
    import torch

    name = type(simulator).__name__
    leaf = torch.tensor(values, requires_grad=True)
    tensor: Any = leaf
    found: Any = simulator.predict(tensor, segments)
    has_history = is_tensor(found) and found.requires_grad
    assert has_history, (
        f"{name} has gradients, but of a tensor its predict gives no tensor with a history"
    )
    assert np.allclose(plain(found), predictions, rtol=1e-10, atol=1e-12), (
        f"{name}.predict gives other numbers for a tensor than for an array: "
        f"{_gap(predictions, plain(found))}"
    )
    # the gradient of a weighted sum of predictions, by autograd and from the sensitivities
    weights = np.random.default_rng(1).standard_normal(predictions.shape)
    gradients = plain(torch.autograd.grad((found * constant(weights, found)).sum(), leaf)[0])
    sensitivities = simulator.jacobian(values[0], segments)
    expected = np.einsum("rp,rpd->d", weights[0], sensitivities)
    scale = np.einsum("rp,rpd->d", np.abs(weights[0]), np.abs(sensitivities))
    errors = np.abs(gradients[0] - expected)
    i = int(np.argmax(errors / (scale + 1e-300)))
    assert errors[i] <= rtol * scale[i], (
        f"{name}: the gradient of a weighted sum of predictions by {simulator.space.names[i]} is "
        f"{gradients[0, i]:.6g}, its Jacobian gives {expected[i]:.6g}"
    )


def _check_failures(
    simulator: Simulator, segments: Segments, values: Array, predictions: Array, diverging: Array
) -> None:
    """A failed simulation gives NaN, is counted, and leaves the others alone."""
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
    """Returns the index nearest to the middle at which no chain of segments is cut, or 0."""
    crossed = np.zeros(len(segments) + 1, dtype=int)
    linked = np.flatnonzero(segments.previous >= 0)
    np.add.at(crossed, segments.previous[linked] + 1, 1)
    np.add.at(crossed, linked + 1, -1)
    uncrossed = np.flatnonzero(np.cumsum(crossed)[:-1] == 0).tolist()
    cuts = [i for i in uncrossed if i > 0]
    return min(cuts, key=lambda i: abs(i - len(segments) / 2), default=0)


def _gap(one: Array, other: Array) -> str:
    """Returns a few words on how far two arrays are apart."""
    if one.shape != other.shape:
        return f"shapes {one.shape} and {other.shape}"
    return f"a largest difference of {np.nanmax(np.abs(one - other)):.3g}"
