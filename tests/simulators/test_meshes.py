"""Meshes that are only seen cost nothing in a simulation, and stay in what is written."""

import copy
import pickle

import mujoco
import numpy as np
import pytest

from benchmarks.meshes import JOINTS, arm_segments, arm_simulator, write_arm
from dropo.core.contracts.effect import EffectInstance, Quantity
from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.core.services.errors import Incompatible
from dropo.core.services.registry import find
from dropo.mjmodel.appearance import posed, shapes
from dropo.mjmodel.files.loading import load_model, model_sum
from dropo.mjmodel.visuals import VisualSettings, without_visuals
from dropo.problems.file.writer import write_problem
from dropo.simulators.mujoco import simulator as simulators
from dropo.simulators.mujoco import worker as workers
from dropo.simulators.mujoco.episodes import Episodes
from dropo.simulators.mujoco.simulator import MujocoSimulator
from dropo.simulators.mujoco.worker import Worker
from tests.reference.stepping import replay_one_by_one

FACES = 2000
EFFECTS = (
    "body_mass",
    "body_com",
    "payload",
    "contact_friction",
    "contact_stiffness",
    "joint_load_friction",
    "actuator_gain",
    "gravity_tilt",
    "air_drag",
)
LOOKS = ("seen", "colliding")


@pytest.fixture(autouse=True)
def every_model_is_worth_it(monkeypatch):
    """Small meshes are dropped too, so that tests are quick."""
    monkeypatch.setattr(
        simulators, "without_visuals", lambda model: without_visuals(model, VisualSettings(0))
    )


@pytest.fixture(scope="module")
def arms(tmp_path_factory):
    """The file of each arm."""
    folder = tmp_path_factory.mktemp("arms")
    return {looks: write_arm(folder, FACES, looks) for looks in LOOKS}


def whole_twin(path, monkeypatch, threads=1):
    """The simulator that simulates with all meshes and textures."""
    with monkeypatch.context() as patch:
        patch.setattr(simulators, "without_visuals", lambda model: model)
        twin = arm_simulator(path, threads)
        twin.general  # noqa: B018 - compiled while it keeps its meshes
    assert twin.simulated is twin.model
    return twin


def instances(simulator, name):
    """All places of an effect, with large magnitudes."""
    found = list(find("effects", name)(simulator.effect_context))
    assert found
    return [(one, np.array([quantity.probes[-1] for quantity in one.quantities])) for one in found]


def draws(simulator, count=3):
    """(K, d) of the box."""
    rng = np.random.default_rng(5)
    return simulator.space.from_unit(rng.uniform(0.2, 0.8, (count, len(simulator.space))))


@pytest.mark.parametrize("looks", LOOKS)
def test_predictions_are_those_of_the_whole_model(arms, looks):
    """Bit for bit those of plain steps of the model as compiled, with contacts; masses and inertias
    that come from meshes are as they were.
    """
    simulator = arm_simulator(arms[looks])
    segments = arm_segments(8)
    found = simulator.predict(simulator.nominal[None], segments)[0]
    model = load_model(str(arms[looks]))
    for binding, value in zip(simulator.bindings, simulator.nominal, strict=True):
        binding.set(model, value)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    columns = [(column.field, column.place) for column in simulator.layout.columns]
    plain = replay_one_by_one(model, segments, columns, simulator.frame_skip)
    expected = simulator.layout.coordinates(plain, segments.targets)
    np.testing.assert_array_equal(found, expected)
    assert simulator.in_contact(segments).any()
    for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_M0"):
        np.testing.assert_array_equal(
            getattr(simulator.simulated, name), getattr(simulator.model, name)
        )
    assert (simulator.simulated.body_mass[1:] > 1).all()


@pytest.mark.parametrize("looks", LOOKS)
@pytest.mark.parametrize("effect", EFFECTS)
def test_effects_act_as_in_the_whole_model(arms, monkeypatch, looks, effect):
    """At every place, geoms among them, and with parameters; the bits do not depend on which effect
    was simulated before.
    """
    simulator = arm_simulator(arms[looks])
    twin = whole_twin(arms[looks], monkeypatch)
    segments = arm_segments(8, 5)
    values = draws(simulator)
    plain = simulator.predict(values, segments)
    changed = False
    places = instances(simulator, effect)
    for pair in {places[0][0].label: places[0], places[-1][0].label: places[-1]}.values():
        found = simulator.with_effects((), [pair]).predict(values, segments)
        expected = twin.with_effects((), [pair]).predict(values, segments)
        np.testing.assert_array_equal(found, expected)
        np.testing.assert_array_equal(simulator.predict(values, segments), plain)
        changed |= not np.array_equal(found, plain)
    assert changed


def test_threads_do_not_matter(arms):
    """One worker a thread, and effects one after another in them, give the same bits."""
    segments = arm_segments(12, 5)
    found = []
    for threads in (1, 4):
        simulator = arm_simulator(arms["seen"], threads)
        pairs = [instances(simulator, name)[-1] for name in ("body_com", "joint_load_friction")]
        values = draws(simulator, 6)
        found.append(
            [simulator.with_effects((), some).predict(values, segments) for some in (pairs, [])]
        )
    np.testing.assert_array_equal(found[1], found[0])


@pytest.mark.parametrize("room", [0, 3, 100])
def test_load_friction_needs_no_model_for_each_state(arms, monkeypatch, room):
    """However many models there is memory for, the bits are the same, and no more are held."""
    simulator = arm_simulator(arms["seen"])
    segments = arm_segments(8, 3)
    pair = instances(simulator, "joint_load_friction")[-1]
    slow = simulator.with_effects((), [pair])
    expected = slow.predict(draws(simulator), segments)
    size = mujoco.mj_sizeModel(simulator.simulated)
    monkeypatch.setattr(workers, "MAX_COPIES", room * size)
    again = arm_simulator(arms["seen"]).with_effects((), [pair])
    np.testing.assert_array_equal(again.predict(draws(simulator), segments), expected)
    worker = again._worker(False)
    assert 1 <= len(worker._twins) <= max(room, 1)


def test_nothing_large_is_copied(arms, monkeypatch):
    """Predictions with effects copy the whole model never, and the simulated one once a thread."""
    simulator = arm_simulator(arms["seen"])
    segments = arm_segments(4, 5)
    copied = []

    def counting(model):
        copied.append(mujoco.mj_sizeModel(model))
        return plain(model)

    plain = mujoco.MjModel.__copy__
    monkeypatch.setattr(mujoco.MjModel, "__copy__", counting)
    for name in ("body_mass", "contact_friction", "actuator_gain"):
        for pair in instances(simulator, name):
            simulator.with_effects((), [pair]).predict(draws(simulator), segments)
    assert len(copied) == 1
    assert copied[0] < 0.3 * mujoco.mj_sizeModel(simulator.model)


@pytest.fixture(scope="module")
def with_puck(arms, tmp_path_factory):
    """An arm beside a body whose frame MuJoCo ties to its centre of mass."""
    puck = """<body name="puck" pos="1 0 0.1"><joint name="slide" type="slide" axis="1 0 0"/>
        <joint name="turn" axis="0 1 0"/><geom name="ball" type="sphere" size="0.1"/></body>"""
    path = arms["seen"].with_name("puck.xml")
    path.write_text(arms["seen"].read_text().replace("</worldbody>", puck + "</worldbody>"))
    return path


def puck_simulator(path):
    """Of the arm's columns, and no parameters."""
    return MujocoSimulator(str(path), [], observation=["qpos[:6]", "qvel"], frame_skip=5, threads=1)


def puck_segments():
    """The arm's, with speeds of the puck."""
    data = arm_segments(4, 5).trajectories
    rows = np.hstack([data.observations, np.full((len(data), 2), 0.5)])
    ends = np.arange(len(data)) % 5 == 4
    return Trajectories(rows, data.actions, rows, ends).segments(5)


def test_general_models_are_compiled_once_and_without_meshes(with_puck, monkeypatch):
    """All simulators that are made of one share the model of effects that move frames; it gives
    the bits of the whole one, in finer steps and in another process too.
    """
    compiled = []

    def counting(*arguments):
        compiled.append(arguments)
        return load_model(*arguments)

    simulator = puck_simulator(with_puck)
    with monkeypatch.context() as patch:
        patch.setattr(simulators, "without_visuals", lambda model: model)
        twin = puck_simulator(with_puck)
        assert twin.general is not twin.model
    monkeypatch.setattr(simulators, "load_model", counting)
    segments = puck_segments()
    values = np.zeros((1, 0))
    pairs = [pair for pair in instances(simulator, "body_com") if pair[0].general]
    assert len(pairs) > 1
    plain = simulator.predict(values, segments)
    changed = []
    for pair in pairs:
        moved = simulator.with_effects((), [pair])
        expected = twin.with_effects((), [pair]).predict(values, segments)
        np.testing.assert_array_equal(moved.predict(values, segments), expected)
        changed.append(not np.array_equal(expected, plain))
        there = pickle.loads(pickle.dumps(moved))
        np.testing.assert_array_equal(there.predict(values, segments), expected)
        finer = [one.with_finer_steps(2).with_effects((), [pair]) for one in (simulator, twin)]
        found = [one.predict(values, segments) for one in finer]
        np.testing.assert_array_equal(found[0], found[1])
    assert len(compiled) == 1
    assert any(changed)
    assert simulator.general.nmeshvert == 0
    written = simulator.model_of(values[0], [pairs[0]])
    assert written.nmeshvert == simulator.model.nmeshvert
    assert not written.body_simple.any()
    coarse = simulator.with_finer_steps(2).model_of(values[0], [pairs[0]])
    assert coarse.opt.timestep == 0.001


def test_what_is_shown_and_written_keeps_the_meshes(arms, tmp_path):
    """The model of the contract is the whole one: its checksum, its picture, its MJCF; so are those
    of simulators that are made of it.
    """
    simulator = arm_simulator(arms["seen"])
    pair = instances(simulator, "body_mass")[-1]
    for one in (simulator, simulator.with_effects((), [pair]), copy.copy(simulator)):
        assert model_sum(one.model) == model_sum(load_model(str(arms["seen"])))
        assert one.model.nmeshvert > one.simulated.nmeshvert == 0
        outlines = shapes(one.model, posed(one.model))
        assert sum(len(shape.points) > 50 for shape in outlines) == JOINTS
        assert one.model_of(one.nominal, [pair]).nmeshvert == one.model.nmeshvert
    finer = simulator.with_finer_steps(2)
    assert finer.model.nmeshvert == simulator.model.nmeshvert
    assert finer.simulated.opt.timestep == finer.model.opt.timestep == 0.001
    problem = Problem("arm", simulator, arm_segments(2, 5).trajectories)
    path = write_problem(problem, tmp_path / "out")
    written = mujoco.MjModel.from_xml_path(str(path.parent / "model.xml"))
    assert written.nmeshvert == simulator.model.nmeshvert
    assert written.ntexdata == simulator.model.ntexdata


def test_other_processes_get_no_meshes(arms):
    """A pickled simulator is small, and gives the same bits, with effects that move frames too."""
    simulator = arm_simulator(arms["seen"])
    segments = arm_segments(4, 5)
    pairs = [instances(simulator, name)[-1] for name in ("body_com", "contact_friction")]
    extended = simulator.with_effects((), pairs)
    content = pickle.dumps(extended)
    assert len(content) < 0.5 * mujoco.mj_sizeModel(simulator.model)
    there = pickle.loads(content)
    values = draws(simulator)
    np.testing.assert_array_equal(
        there.predict(values, segments), extended.predict(values, segments)
    )
    assert there.model_of(values[0], pairs).body_mass[4] == values[0, 0]


def test_episodes_are_without_meshes(arms, monkeypatch):
    """Episodes move on the same bits as those of the whole model."""
    states = []
    for simulator in (arm_simulator(arms["seen"]), whole_twin(arms["seen"], monkeypatch)):
        pairs = [instances(simulator, "joint_load_friction")[-1]]
        episodes = Episodes(simulator.with_effects((), pairs), 3)
        ids = np.arange(3)
        episodes.set(ids, draws(simulator))
        episodes.reset(ids, np.tile([0.1, 1.2, 0.9, 0, 0.4, 0] + [0.0] * JOINTS, (3, 1)))
        for k in range(20):
            assert episodes.step(ids, np.full((3, JOINTS), 0.1 * k)).all()
        states.append(episodes.states(ids))
        sizes = [mujoco.mj_sizeModel(worker.model) for worker in episodes._workers]
        assert set(sizes) == {mujoco.mj_sizeModel(simulator.simulated)}
    np.testing.assert_array_equal(states[1], states[0])


def collide(model, magnitudes):
    """Makes what is only seen collide."""
    model.geom_contype[model.geom("look2").id] = 1


def fail(model, magnitudes):
    """Fails when half is written."""
    model.body_mass[:] = 100.0
    raise ValueError("half way")


def of_model(hook):
    """An effect of one magnitude that changes the model."""
    return EffectInstance("own", None, (Quantity("size", "1", 0.0, 1.0, (1.0,)),), model=hook)


def test_a_lost_mesh_that_is_to_collide_is_refused(arms):
    """It is not there to be touched; with a mesh that collides in the model it works."""
    pair = (of_model(collide), np.ones(1))
    segments = arm_segments(2, 3)
    seen = arm_simulator(arms["seen"])
    with pytest.raises(Incompatible, match="'look2' collide"):
        seen.with_effects((), [pair]).predict(draws(seen), segments)
    arm_simulator(arms["colliding"]).with_effects((), [pair]).predict(draws(seen), segments)


def test_a_failed_effect_leaves_no_trace(arms):
    """What a hook wrote before it failed is put back before the next prediction."""
    simulator = arm_simulator(arms["seen"])
    segments = arm_segments(2, 3)
    expected = simulator.predict(draws(simulator), segments)
    with pytest.raises(ValueError, match="half way"):
        simulator.with_effects((), [(of_model(fail), np.ones(1))]).predict(
            draws(simulator), segments
        )
    np.testing.assert_array_equal(simulator.predict(draws(simulator), segments), expected)


def test_a_worker_puts_all_numbers_back(arms):
    """After effects, the model of a worker equals that of a new one in every number."""
    simulator = arm_simulator(arms["seen"])
    worker = Worker(simulator.simulated, simulator.bindings)
    values = draws(simulator)
    pairs = [pair for name in EFFECTS for pair in instances(simulator, name)]
    worker.set(values[0], [pair for pair in pairs if not pair[0].general])
    worker.set(values[1])
    new = Worker(simulator.simulated, simulator.bindings)
    new.set(values[1])
    for name in dir(new.model):
        value = None if name.startswith("_") else getattr(new.model, name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(worker.model, name), value, err_msg=name)
    assert worker.model.stat.meaninertia == new.model.stat.meaninertia
    np.testing.assert_array_equal(worker.model.opt.gravity, new.model.opt.gravity)
