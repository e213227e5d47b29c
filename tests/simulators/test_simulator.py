"""MujocoSimulator against a plain loop over mj_step, and what it promises: the same bits always,
failures by row, exact counts.
"""

import copy
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np
import pytest

from dropo.core.contracts.effect import instances_of
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import BadArgument, BadFile, Incompatible
from dropo.mjmodel.fields import FieldParameter
from dropo.mjmodel.warnings import suppress_mujoco_warnings
from dropo.problems.simulated.robots import masses, simulated_robot
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.testing import check_simulator
from tests.models.cases import BOX, CART, CASES, CUTS, PENDULUM, SENSED, Case, mass, places
from tests.reference.stepping import load, replay_one_by_one

every_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES)
every_cut = pytest.mark.parametrize("cut", CUTS)


def draws(simulator, count=4, seed=1):
    """(K, d) of the box."""
    return simulator.space.from_unit(
        np.random.default_rng(seed).uniform(0.2, 0.8, (count, len(simulator.space)))
    )


def twin_of(case, simulator, value, segments):
    """(R, p) by hand: written in the derived parameters, then mj_setConst, then in the others, then
    stepped in a loop.
    """
    model = load(case.xml)
    for derived in (True, False):
        for parameter, number in zip(simulator.space, value, strict=True):
            if parameter.derived is derived:
                kind = {"body": model.body, "dof": model.joint, "actuator": model.actuator}[
                    parameter.field.split("_")[0]
                ]
                name = {"dof_damping": "damping"}.get(
                    parameter.field, parameter.field.split("_")[-1]
                )
                getattr(kind(parameter.element), name)[parameter.index or 0] = number
        if derived:
            mujoco.mj_setConst(model, mujoco.MjData(model))
    return simulator.layout.coordinates(
        replay_one_by_one(model, segments, case.columns, case.frame_skip), segments.targets
    )


@every_case
@every_cut
def test_keeps_to_the_contract(case, cut):
    """The checks that plug-in authors call are silent: shapes, counts, determinism, splits, groups,
    offsets, Jacobians.
    """
    check_simulator(case.simulator(), case.segments(cut))


@every_case
@every_cut
def test_equals_stepping_by_hand(case, cut):
    """Every compared number is the plain loop's, to the last bit; the control: another parameter
    vector gives others.
    """
    simulator = case.simulator()
    segments = case.segments(cut)
    values = draws(simulator, 2)
    found = simulator.predict(values, segments)
    for value, mine in zip(values, found, strict=True):
        np.testing.assert_array_equal(mine, twin_of(case, simulator, value, segments))
    assert np.abs(found[1] - found[0]).max() > 1e-6


@every_case
@every_cut
def test_bits_do_not_depend_on_threads(case, cut):
    """1, 2 and 5 threads give the same numbers, for few draws (segments are dealt out) and for
    many.
    """
    segments = case.segments(cut)
    for count in (1, 11):
        one, two, five = (
            case.simulator(threads).predict(draws(case.simulator(), count), segments)
            for threads in (1, 2, 5)
        )
        np.testing.assert_array_equal(one, two)
        np.testing.assert_array_equal(one, five)


@every_case
def test_bits_do_not_depend_on_order_or_company(case):
    """Any order of the draws, and any subset of the segments in any order, gives equal numbers."""
    simulator = case.simulator(3)
    segments = case.segments("transitions")
    rng = np.random.default_rng(2)
    values = draws(simulator, 9)
    whole = simulator.predict(values, segments)
    for _ in range(5):
        k = rng.permutation(9)[:6]
        n = rng.permutation(len(segments))[:7]
        np.testing.assert_array_equal(
            simulator.predict(values[k], segments.take(n)), whole[np.ix_(k, n)]
        )


def test_calls_may_overlap():
    """Several threads may ask one simulator at once, and the user's own handler of warnings is back
    afterwards.
    """
    simulator = CASES["box"].simulator(2)
    segments = CASES["box"].segments("lambda")
    values = draws(simulator, 12)
    before = mujoco.get_mju_user_warning()
    alone = [simulator.predict(v[None], segments) for v in values]
    with ThreadPoolExecutor(6) as pool:
        together = list(pool.map(lambda v: simulator.predict(v[None], segments), values))
    np.testing.assert_array_equal(alone, together)
    assert mujoco.get_mju_user_warning() is before


def test_overlapping_silences_end_with_the_users_handler():
    """The second to begin outlasts the first: MuJoCo warns through the user's handler again, and
    not before.
    """
    before = mujoco.get_mju_user_warning()
    own = lambda message: None
    mujoco.set_mju_user_warning(own)
    try:
        first = suppress_mujoco_warnings()
        second = suppress_mujoco_warnings()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert mujoco.get_mju_user_warning() is not own
        second.__exit__(None, None, None)
        assert mujoco.get_mju_user_warning() is own
    finally:
        mujoco.set_mju_user_warning(before)


def test_kept_constants_do_not_depend_on_what_ran_before():
    """With one mass that derived constants follow and one that they do not, the draw before leaves
    no trace.
    """
    case = CASES["box"]
    segments = case.segments("lambda")
    values = draws(case.simulator(), 2)
    fresh = case.simulator()
    used = case.simulator()
    used.predict(values[1:], segments)
    np.testing.assert_array_equal(
        fresh.predict(values[:1], segments), used.predict(values[:1], segments)
    )


def test_start_is_one_long_rollout():
    """`reset="start"` ignores every measurement but a trajectory's first: 12 steps of 3 physics
    steps in one go.
    """
    case = CASES["pendulum"]
    simulator = MujocoSimulator(mujoco.MjSpec.from_string(PENDULUM), case.parameters, frame_skip=3)
    data = case.data((12,))
    model = load(PENDULUM)
    state = mujoco.MjData(load(PENDULUM))
    state.qpos[:], state.qvel[:] = data.observations[0]
    expected = []
    for action in data.actions:
        state.ctrl[:] = action
        mujoco.mj_step(model, state, 3)
        expected.append([state.qpos[0], state.qvel[0]])
    found = simulator.predict(simulator.nominal[None], data.segments(reset="start"))
    np.testing.assert_array_equal(found[0], expected)


def test_unobserved_state_starts_at_the_models_own():
    """Of the cart only velocities are observed: positions begin at qpos0, here 0.2 m, whatever ran
    before.
    """
    case = Case(CART, CASES["cart"].parameters, ("qvel",), places(qvel=2), (True, False))
    simulator = case.simulator()
    segments = case.segments("every step")
    assert simulator.model.qpos0[0] == 0.2
    values = draws(simulator, 1)
    np.testing.assert_array_equal(
        simulator.predict(values, segments)[0], twin_of(case, simulator, values[0], segments)
    )


def test_unobserved_activation_starts_at_zero():
    """An actuator's state that is not observed begins at zero."""
    valve = CASES["valve"]
    case = Case(
        valve.xml, valve.parameters, ("qpos", "qvel"), places(qpos=1, qvel=1), (True, False)
    )
    simulator = case.simulator()
    segments = case.segments("start")
    values = draws(simulator, 1)
    np.testing.assert_array_equal(
        simulator.predict(values, segments)[0], twin_of(case, simulator, values[0], segments)
    )


def test_sensors_are_those_after_the_step():
    """An accelerometer and a force sensor show the state after an action, under that action, alone
    or in a longer segment.

    The control: mj_step itself leaves the sensors of the state before it.
    """
    case = CASES["sensed"]
    simulator = case.simulator()
    data = case.data((5,))
    every = simulator.predict(simulator.nominal[None], data.segments(3, every_step=True))[0]
    np.testing.assert_array_equal(
        every[:, 6], data.actions[:3, 0]
    )  # the force sensor reads the action just held
    one = simulator.predict(simulator.nominal[None], data.segments(1))[0]
    np.testing.assert_array_equal(every[0], one[0])
    model = load(SENSED)
    state = mujoco.MjData(model)
    state.qpos[:], state.qvel[:], state.ctrl[:] = (
        data.observations[0, 0],
        data.observations[0, 1],
        data.actions[0],
    )
    mujoco.mj_step(model, state, 2)
    assert abs(state.sensordata[3] - one[0, 5]) > 1e-4
    mujoco.mj_forward(model, state)
    np.testing.assert_array_equal(state.sensordata, one[0, 2:])


def test_actions_go_to_the_named_actuators():
    """One action column for the second actuator of two: the first stays at zero."""
    case = CASES["cart"]
    simulator = MujocoSimulator(
        mujoco.MjSpec.from_string(CART), case.parameters, action=["ctrl[1]"], frame_skip=2
    )
    data = case.data()
    single = Trajectories(
        data.observations, data.actions[:, 1:], data.next_observations, data.terminals
    )
    both = Trajectories(
        data.observations, data.actions * [0, 1], data.next_observations, data.terminals
    )
    values = draws(simulator)
    np.testing.assert_array_equal(
        simulator.predict(values, single.segments()),
        case.simulator().predict(values, both.segments()),
    )


@pytest.mark.parametrize("name", ["box", "ball"])
def test_offsets_move_starts_in_the_tangent_space(name):
    """A start moved by an offset is mj_integratePos of the measured one; velocities move by
    addition.
    """
    case = CASES[name]
    simulator = case.simulator()
    data = case.data()
    rng = np.random.default_rng(3)
    model = simulator.model
    values = draws(simulator, 3)
    offsets = 0.3 * rng.normal(size=(3, len(data), 2 * model.nv))
    found = simulator.predict(values, data.segments(), offsets=offsets)
    for k, value in enumerate(values):
        moved = data.observations.copy()
        for row, offset in zip(moved, offsets[k], strict=True):
            position = row[: model.nq].copy()
            mujoco.mj_integratePos(model, position, offset[: model.nv], 1.0)
            row[:] = [*position, *(row[model.nq :] + offset[model.nv :])]
        other = Trajectories(moved, data.actions, data.next_observations, data.terminals)
        np.testing.assert_allclose(
            found[k], simulator.predict(value[None], other.segments())[0], atol=1e-9
        )


@pytest.mark.parametrize("name", ["box", "ball"])
def test_signs_of_quaternions_do_not_matter(name):
    """q and -q are one rotation, in the measured starts and in the measured ends."""
    case = CASES[name]
    simulator = case.simulator()
    data = case.data()
    quaternion = slice(3, 7) if name == "box" else slice(0, 4)
    flips = np.where(np.random.default_rng(4).random((2, len(data), 1)) < 0.5, -1.0, 1.0)
    rows = [data.observations.copy(), data.next_observations.copy()]
    for array, flip in zip(rows, flips, strict=True):
        array[:, quaternion] *= flip
    flipped = Trajectories(rows[0], data.actions, rows[1], data.terminals)
    values = draws(simulator, 2)
    np.testing.assert_allclose(
        simulator.predict(values, flipped.segments()),
        simulator.predict(values, data.segments()),
        atol=1e-12,
    )
    np.testing.assert_allclose(
        simulator.targets(flipped.segments())[:, quaternion.start : quaternion.start + 3],
        0.0,
        atol=1e-15,
    )


def growing():
    """A pendulum whose negative damping blows it up, at a rate that depends on the value."""
    damping = FieldParameter("damping", -100.0, 1.0, field="dof_damping", element="pivot")
    return MujocoSimulator(mujoco.MjSpec.from_string(PENDULUM), [damping], threads=2), CASES[
        "pendulum"
    ].data((30, 20))


def test_a_diverging_simulation_marks_its_own_rows(tmp_path, monkeypatch, capfd):
    """From the step at which it diverges, and nowhere else; it is counted once a segment, and
    MuJoCo writes no log.
    """
    monkeypatch.chdir(tmp_path)
    simulator, data = growing()
    segments = data.segments(reset="start")
    sound = simulator.predict([[0.1], [0.3]], segments)
    mixed = simulator.predict([[0.1], [-30.0], [0.3]], segments)
    np.testing.assert_array_equal(mixed[[0, 2]], sound)
    lost = np.isnan(mixed[1]).all(axis=1)
    assert simulator.failures == len({int(i) for i in segments.rows[0][lost]}) == 2
    for i in range(2):
        mine = lost[segments.rows[0] == i]
        first = int(mine.argmax())
        assert 0 < first < len(mine) - 1
        assert mine[first:].all()
        assert not mine[:first].any()
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_a_failed_link_fails_the_rest_of_its_chain():
    """With partial resets, segments that go on from a failed one fail too; another trajectory's do
    not.
    """
    simulator, data = growing()
    wild = data.observations.copy()
    wild[6, 1] = 1e12
    trajectories = Trajectories(wild, data.actions, data.next_observations, data.terminals)
    chained = trajectories.segments(2, reset="partial", set_columns=[False, True])
    lost = np.isnan(simulator.predict([[0.1]], chained)[0]).all(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(lost), np.arange(3, 15))
    assert simulator.failures == 12


def test_contract_holds_around_a_failure():
    """The shipped checks, with a value that diverges."""
    simulator, data = growing()
    check_simulator(
        simulator, data.segments(reset="start"), values=[[0.1], [0.2], [0.4]], diverging=[-40.0]
    )


@pytest.mark.parametrize(
    ("cut", "transitions"),
    [("transitions", 18), ("lambda", 18), ("every step", 15), ("start", 18), ("partial", 18)],
)
def test_steps_are_counted_exactly(cut, transitions):
    """Draws times replayed transitions times physics steps: lambda = 3 leaves two rows of the first
    trajectory and one of the last.
    """
    simulator = CASES["cart"].simulator(2)
    simulator.predict(draws(simulator, 5), CASES["cart"].segments(cut))
    assert simulator.steps == 5 * transitions * 2


def test_values_by_group():
    """Row g of the values meets the segments of group g; fewer rows than groups are refused."""
    case = CASES["ball"]
    simulator = case.simulator()
    segments = case.segments("every step")
    values = draws(simulator, 6).reshape(2, 3, 2)
    found = simulator.predict(values, segments)
    for g in range(3):
        mine = segments.group[segments.rows[0]] == g
        np.testing.assert_array_equal(
            found[:, mine], simulator.predict(values[:, g], segments)[:, mine]
        )
    words = (
        r"^The 'values' of MujocoSimulator.predict must be given for 3 "
        r"groups. Got \(2, 2, 2\) instead.$"
    )
    with pytest.raises(BadArgument, match=words):
        simulator.predict(values[:, :2], segments)


def test_file_spec_and_model_are_the_same(tmp_path):
    """An MJCF file, an MjSpec and an MjModel give the same numbers, and the given model stays as it
    was.
    """
    case = CASES["pendulum"]
    path = tmp_path / "pendulum.xml"
    path.write_text(PENDULUM)
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    before = copy.copy(model)
    simulators = [
        MujocoSimulator(m, case.parameters)
        for m in (path, str(path), mujoco.MjSpec.from_string(PENDULUM), model)
    ]
    values = draws(simulators[0])
    segments = case.segments("lambda")
    found = [simulator.predict(values, segments) for simulator in simulators]
    assert all(np.array_equal(found[0], other) for other in found[1:])
    np.testing.assert_array_equal(model.body_mass, before.body_mass)
    assert model.opt.disableflags == before.opt.disableflags
    assert simulators[0].control_step == 0.01
    np.testing.assert_allclose(simulators[0].nominal, [0.4, 0.1])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            {"frame_skip": 0},
            "The 'frame_skip' of MujocoSimulator must be at least 1. Got 0 instead.",
        ),
        (
            {"threads": -1},
            r"The 'threads' of MujocoSimulator must be 0 \(all cores\) or a "
            r"number of threads. Got -1 instead.",
        ),
        (
            {"action": ["ctrl", "ctrl[0]"]},
            r"The action items \['ctrl', 'ctrl\[0\]'\] name an actuator twice.",
        ),
        ({"action": ["ctrl.torqe"]}, "No element of ctrl called 'torqe'. Did you mean 'torque'?"),
        ({"action": ["ctrl[1]"]}, r"The item 'ctrl\[1\]' is outside of ctrl, which has 1 numbers."),
    ],
)
def test_refuses_bad_settings(arguments, words):
    """The message names the argument, the rule and what was got."""
    with pytest.raises(ValueError, match="^" + words.replace("?", r"\?") + "$"):
        MujocoSimulator(
            mujoco.MjSpec.from_string(PENDULUM), CASES["pendulum"].parameters, **arguments
        )


def test_refuses_data_of_another_width():
    """Data of the cart do not fit the pendulum, nor do two actions."""
    simulator = CASES["pendulum"].simulator()
    with pytest.raises(
        BadArgument,
        match=(
            r"^The 'segments' of MujocoSimulator.predict must be of 2 "
            r"observed columns. Got 4 instead.$"
        ),
    ):
        simulator.predict(draws(simulator), CASES["cart"].segments("transitions"))
    data = CASES["pendulum"].data()
    wide = Trajectories(
        data.observations, np.tile(data.actions, 2), data.next_observations, data.terminals
    )
    with pytest.raises(
        BadArgument,
        match=r"^The 'segments' of MujocoSimulator must be of 1 action columns. Got 2 instead.$",
    ):
        simulator.predict(draws(simulator), wide.segments())


def test_refuses_files_that_are_no_models(tmp_path):
    """A missing file, and one that does not compile, with the compiler's own words."""
    with pytest.raises(BadFile, match=r"gone.xml: expected an MJCF file, got no such file.$"):
        MujocoSimulator(tmp_path / "gone.xml", [])
    (tmp_path / "bad.xml").write_text(PENDULUM.replace('mass="0.4"', 'mass="heavy"'))
    with pytest.raises(BadFile, match=r"bad.xml: expected a model that compiles, got .*mass"):
        MujocoSimulator(tmp_path / "bad.xml", [])
    spec = mujoco.MjSpec.from_string(PENDULUM)
    spec.actuators[0].target = "nowhere"
    with pytest.raises(BadFile, match=r"^the model: expected a model that compiles, got .*nowhere"):
        MujocoSimulator(spec, [])


def test_moving_frames_needs_the_source_of_the_model():
    """mj_setConst cannot follow body_ipos in a model that was compiled without knowing of it."""
    offset = FieldParameter("height", -0.1, 0.1, "m", field="body_ipos", element="box", index=2)
    words = (
        r"^The 'model' of MujocoSimulator must be an MJCF file or an MjSpec where "
        r"\['body_ipos'\] is fitted. Got 'an MjModel' instead.$"
    )
    with pytest.raises(BadArgument, match=words):
        MujocoSimulator(mujoco.MjModel.from_xml_string(BOX), [offset, mass("flap")])


@pytest.mark.parametrize("name", ["hopper", "half-cheetah", "torque-arm"])
def test_a_single_tree_does_not_look_for_islands(name):
    """With islands of constraints looked for, a machine of one tree does the same bit for bit; data
    with contacts.
    """
    robot = simulated_robot(name, masses(name))
    segments = robot.record(noise=1e-3, rng=np.random.default_rng(0)).segments(10)
    values = np.asarray(robot.simulator.nominal) * np.array([[0.9], [1.0]])
    found = robot.simulator.predict(values, segments)
    assert robot.simulator.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ISLAND
    looking = simulated_robot(name, masses(name)).simulator
    looking.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    assert np.array_equal(found, looking.predict(values, segments))


def test_finer_steps_are_those_of_a_model_with_a_shorter_step():
    """Half the step and twice as many: bit for bit, with an effect that moves frames too."""
    robot = simulated_robot("torque-arm")
    simulator = robot.simulator
    instances = instances_of(simulator.effect_context, "body_com", "fore.x")
    extended = simulator.with_effects((), [(instances[0], np.array([0.02]))])
    spec = simulator.spec()
    spec.option.timestep /= 2
    twin = MujocoSimulator(
        spec,
        [binding.parameter for binding in simulator.bindings],
        observation=simulator.observation,
        frame_skip=2 * simulator.frame_skip,
        threads=1,
    )
    twin = twin.with_effects((), [(instances[0], np.array([0.02]))])
    segments = robot.record(noise=1e-3, rng=np.random.default_rng(0)).segments(5)
    finer = extended.with_finer_steps(2)
    assert finer.control_step == extended.control_step == twin.control_step
    values = simulator.nominal[None]
    np.testing.assert_array_equal(finer.predict(values, segments), twin.predict(values, segments))
    assert np.ptp(finer.predict(values, segments) - extended.predict(values, segments)) > 0


def test_observing_more_keeps_the_source():
    """A simulator that observes other columns can still be written as MJCF."""
    simulator = simulated_robot("torque-arm").simulator
    assert simulator.observing(["qvel"]).spec().to_xml() == simulator.spec().to_xml()


def test_refuses_a_body_that_moves_without_a_mass():
    """MuJoCo's fatal error, as a damaged fit.json may lead to, is a refusal."""
    sliding = (
        '<mujoco><worldbody><body name="cart"><joint type="slide" axis="1 0 0"/>'
        '<geom size="0.1" mass="2"/></body></worldbody></mujoco>'
    )
    mass = FieldParameter("mass", 0.1, 1.0, "kg", field="body_mass", element="cart")
    simulator = MujocoSimulator(mujoco.MjSpec.from_string(sliding), [mass])
    words = r"MuJoCo takes no model with these parameters: .* 0 mass"
    with pytest.raises(Incompatible, match=words):
        simulator.model_of(np.zeros(1))
