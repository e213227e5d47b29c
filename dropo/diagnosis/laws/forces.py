"""The forces at the joints that nothing explains yet, and the states in which they act.

A window's residuals are R w + B z + e: forces w, a constant one at each degree of freedom in each
piece of the window, errors z of its start, and noise e. So a formula's values in the pieces, times
R, are what it would change, and regressing the whitened residuals on that is regressing the forces
on the formula with their covariance in time. Contacts are in R, which is simulated.
"""

from dataclasses import dataclass, replace

import numpy as np

from dropo.core.contracts.effect import ActiveEffects, RecordedPast, StepState, magnitudes_of
from dropo.core.services.validation import Array
from dropo.diagnosis.findings.remains.unexplained_forces import impulses_of, responses_to
from dropo.diagnosis.search.linearization import Library, LinearizedWindows
from dropo.diagnosis.search.noise_learning import learn_noise
from dropo.diagnosis.search.trials import State
from dropo.diagnosis.search.whitening import Whitener
from dropo.mjmodel.robot_simulator import RobotSimulator
from dropo.simulators.mujoco.layers import changes_commands, commands_per_physics_step

RANK = 1e-9
"""Relative length below which what remains of a column is rounding."""


@dataclass(frozen=True, eq=False)
class ResidualForces:
    """What W windows say of forces that nothing explains.

    Attributes
    ----------
    windows : LinearizedWindows
        The windows, with random forces in their covariance.
    responses : (W, n, P, nv) array
        The change of the residuals by a force at each degree of freedom in each of P pieces.
    explained : (1 + f, N) array
        What is explained anyway, whitened: by the length of the physics step, and by each of f
        fitted numbers.
    numbers : (f,) array of int
        Where these are in theta.
    basis : (N, g) array
        The same, orthonormal.
    residuals : (N,) array
        The whitened residuals without that.
    states : StepState
        Of W (L + 1) states: those of each window in turn.
    past : RecordedPast
        The data, for hidden states.
    steps : (W, L) array of int
        The row of the data of each step.
    length : int
        L, control steps in a window.
    """

    windows: LinearizedWindows
    responses: Array
    explained: Array
    numbers: np.ndarray
    basis: Array
    residuals: Array
    states: StepState
    past: RecordedPast
    steps: np.ndarray
    length: int

    @property
    def variance(self) -> float:
        """The mean square of the whitened residuals, at least a half."""
        count = max(self.windows.residuals[~self.windows.lost].size, 1)
        return max(float(self.residuals @ self.residuals) / count, 0.5)

    def by_piece(self, values: Array) -> Array:
        """Average values at states over the pieces of windows.

        Parameters
        ----------
        values : (..., W (L + 1)) array
            One number for each state of each window in turn.

        Returns
        -------
        (..., W, P) array
            Means over the steps of each piece, in the values' unit; a step has the mean of its two
            states.
        """
        count = len(self.responses)
        at = values.reshape(*values.shape[:-1], count, self.length + 1)
        steps = 0.5 * (at[..., 1:] + at[..., :-1])
        pieces = self.responses.shape[2]
        piece = np.arange(self.length) * pieces // self.length
        inside = (piece[:, None] == np.arange(pieces)).astype(float)
        return np.asarray(steps @ (inside / inside.sum(axis=0)))

    def rows(self, values: Array, dof: int) -> Array:
        """Whiten what forces at a degree of freedom change.

        Parameters
        ----------
        values : (K, W (L + 1)) array
            K forces in all states [N, N m].
        dof : int
            Where they act.

        Returns
        -------
        (K, N) array
        """
        return self.windows.flat(self.changes(values, dof))

    def changes(self, values: Array, dof: int) -> Array:
        """Return what forces at a degree of freedom change.

        Parameters
        ----------
        values : (K, W (L + 1)) array
            K forces in all states [N, N m].
        dof : int
            Where they act.

        Returns
        -------
        (K, W, n) array
            Of the predictions, in the signals' units.
        """
        pieces = self.by_piece(values)
        return np.asarray(np.einsum("wnp,kwp->kwn", self.responses[..., dof], pieces))

    def unexplained(self, rows: Array) -> tuple[Array, Array]:
        """Take what is explained anyway out of whitened changes.

        Parameters
        ----------
        rows : (K, N) array
            As `rows` gives them.

        Returns
        -------
        left : (K, N) array
            Whitened changes of the residuals, orthogonal to what is explained anyway; 0 where only
            rounding is left.
        lengths : (K,) array
            Lengths of the changes before that was taken out.
        """
        left = rows - (rows @ self.basis) @ self.basis.T
        # What is as good as explained is rounding.
        lengths = np.linalg.norm(rows, axis=1)
        left[np.linalg.norm(left, axis=1) < RANK * lengths] = 0.0
        return left, lengths

    def without(self, numbers: np.ndarray, changes: Array) -> "ResidualForces":
        """Return the forces that are missing without what some fitted numbers stand for.

        Parameters
        ----------
        numbers : (g,) array of int
            Their places in theta.
        changes : (W, n) array
            What that changes of the predictions, linearized where the responses are: forces are
            missed by as much as it explains.

        Returns
        -------
        ResidualForces
            In the same states, with the covariance of the forces that are missing with it.
        """
        side = self.windows
        kept = np.append(True, ~np.isin(self.numbers, numbers))
        explained = self.explained[kept]
        basis = np.linalg.qr(explained.T)[0]
        whole = side.flat(side.residuals + changes)
        return replace(
            self,
            explained=explained,
            numbers=self.numbers[kept[1:]],
            basis=basis,
            residuals=whole - basis @ (basis.T @ whole),
        )


def residual_forces(library: Library, state: State, floor: Array) -> ResidualForces:
    """Find what a state's windows to fit say of forces that it does not explain.

    Parameters
    ----------
    library : Library
        With impulses among its effects, around a `RobotSimulator`.
    state : State
        The model with what was found.
    floor : (p,) array
        Lower bound of the noise.

    Returns
    -------
    ResidualForces

    Raises
    ------
    AssertionError
        If the simulator is not a `MujocoSimulator`, around which alone laws are looked for.
    """
    simulator = library.simulator
    if not isinstance(simulator, RobotSimulator):
        raise AssertionError("laws are looked for around a MuJoCo model")
    train = state.train
    instances = impulses_of(library)
    nv = len({instance.target for instance in instances})
    pieces = len(instances) // nv
    responses = responses_to(library, train, instances)
    unit = np.array([instance.quantities[0].probes[0] for instance in instances[:nv]])
    good = ~train.lost
    noise, sd = learn_noise(
        np.concatenate([train.start_loadings, responses], axis=2)[good],
        train.residuals[good],
        train.whiten.noise,
        floor,
        unit,
        pieces=pieces,
        known=train.known_loadings[good],
        counted=train.windows.counted,
    )
    known = train.known_loadings
    loadings = np.concatenate([train.start_loadings, responses, known], axis=2)
    ones = np.ones(known.shape[2])
    scale = np.concatenate([np.tile(noise.sigma, 2), np.tile(sd, pieces), ones])
    windows = replace(train, whiten=Whitener(loadings, scale, noise, train.windows.counted))
    # What fitted numbers explain, and the length of the physics step, is no force.
    space = simulator.space
    free = state.free
    free = free[(train.theta[free] > space.low[free]) & (train.theta[free] < space.high[free])]
    explained = [step_errors(simulator, train)[None]]
    if len(free):
        explained.append(library.jacobian(train.theta, free, train.windows))
    rows = windows.flat(np.concatenate(explained))
    basis = np.linalg.qr(rows.T)[0]
    residuals = windows.flat(windows.residuals)
    residuals = residuals - basis @ (basis.T @ residuals)
    by_latent = np.concatenate([train.start_loadings, responses], axis=2)
    states, past = _states(simulator, state, windows, by_latent)
    return ResidualForces(
        windows=windows,
        responses=responses.reshape(*responses.shape[:2], pieces, nv),
        explained=rows,
        numbers=free,
        basis=basis,
        residuals=residuals,
        states=states,
        past=past,
        steps=train.windows.segments.steps,
        length=train.windows.length,
    )


def step_errors(simulator: RobotSimulator, side: LinearizedWindows) -> Array:
    """Estimate what predictions would change with infinitely short physics steps.

    Parameters
    ----------
    simulator : RobotSimulator
        The model with every effect.
    side : LinearizedWindows
        W windows of n measurements.

    Returns
    -------
    (W, n) array
        Twice the change by half the step, as of an integrator of first order; 0 where a simulation
        diverges.
    """
    finer = simulator.with_finer_steps(2)
    predicted = finer.predict(side.theta[None], side.windows.segments)
    simulator.steps += finer.steps
    own = side.predicted if side.defect is None else side.predicted + side.defect
    change = predicted.reshape(side.residuals.shape) - own
    return np.asarray(2 * np.nan_to_num(change))


def _states(
    simulator: RobotSimulator, state: State, windows: LinearizedWindows, loadings: Array
) -> tuple[StepState, RecordedPast]:
    """The states of all windows as estimated from their measurements, and the data.

    loadings: (W, n, k) of errors of the start and of forces.
    """
    segments = windows.windows.segments
    data = segments.trajectories
    layout = simulator.layout
    count, length = segments.steps.shape
    p = len(windows.whiten.sigma)

    # Signals: what was simulated, moved by what the measurements say of start and forces.
    latent = windows.whiten.latent(windows.residuals)[:, : loadings.shape[2]]
    latent[windows.lost] = 0.0
    latent[:, p : 2 * p] = 0.0
    moved = np.einsum("wnk,wk->wn", loadings, latent) - windows.residuals
    moved[windows.lost] = 0.0
    measured = data.next_observations[segments.steps]
    later = layout.move(
        measured.reshape(count * length, -1), moved.reshape(count * length, p)
    ).reshape(count, length, -1)
    first = layout.move(segments.starts, latent[:, :p])
    rows = np.concatenate([first[:, None], later], axis=1).reshape(count * (length + 1), -1)
    model = simulator.model_of(state.theta, _active(state, simulator))
    full = layout.full_states(rows, model)

    # Commands, as accepted effects change them, in the mean over each step.
    begins = np.array(data.spans)[data.trajectory[segments.steps[:, 0]], 0]
    commands = simulator.commands_of(data.actions)
    active = _active(state, simulator)
    whole = commands[segments.steps]
    if changes_commands(active):
        everything = np.arange(count)
        changed = commands_per_physics_step(
            segments, everything, commands, model, simulator.frame_skip, active
        )
        whole = changed.reshape(count, length, simulator.frame_skip, -1).mean(axis=2)
    held = np.concatenate([whole, whole[:, -1:]], axis=1).reshape(count * (length + 1), -1)
    steps = segments.steps[:, :1] - begins[:, None] + np.arange(length + 1)
    time = (simulator.control_step * steps).ravel()
    qpos, qvel, act = np.split(full[:, 1:], np.cumsum([model.nq, model.nv]), axis=1)
    states = StepState(qpos, qvel, held, 0, act, model, time)

    return states, simulator.recorded_past(segments, np.arange(count))


def _active(state: State, simulator: RobotSimulator) -> ActiveEffects:
    """The effects of a state with their magnitudes."""
    free = magnitudes_of(simulator.effects, state.theta[len(simulator.bindings) :])
    return [*simulator.fixed, *free]
