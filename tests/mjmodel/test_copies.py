"""A copy whose numbers are put back equals one that is made anew."""

import copy

import mujoco
import numpy as np
import pytest

from benchmarks.meshes import write_arm
from dropo.mjmodel.copies import LARGE, ModelCopy


def everything(model):
    """All numbers of a model that can be read."""
    found = {}
    for part in ("", "opt", "stat"):
        owner = getattr(model, part) if part else model
        for name in dir(owner):
            value = None if name.startswith("_") else getattr(owner, name)
            if isinstance(value, np.ndarray | int | float):
                found[f"{part}.{name}"] = np.array(value)
    return found


def test_all_numbers_are_put_back(tmp_path):
    """Every array that is no mesh or picture, options and statistics, whatever was written."""
    model = mujoco.MjModel.from_xml_path(str(write_arm(tmp_path, 400, "colliding")))
    own = ModelCopy(model)
    changed = 0
    for name in dir(own.model):
        value = None if name.startswith("_") else getattr(own.model, name)
        if isinstance(value, np.ndarray) and value.size and name not in LARGE:
            value[...] = 7
            changed += 1
    own.model.opt.timestep = 0.5
    own.model.opt.disableflags = 3
    own.model.opt.gravity[:] = 1
    own.model.stat.meaninertia = 9
    before = everything(own.model)
    own.restore()
    there = everything(copy.copy(model))
    here = everything(own.model)
    assert changed > 100
    assert here.keys() == there.keys()
    for name, value in there.items():
        np.testing.assert_array_equal(here[name], value, err_msg=name)
    assert any(not np.array_equal(before[name], there[name]) for name in there)


def test_what_is_not_put_back_cannot_be_written(tmp_path):
    """A change of a mesh would stay, so it is refused."""
    model = mujoco.MjModel.from_xml_path(str(write_arm(tmp_path, 400, "colliding")))
    own = ModelCopy(model)
    with pytest.raises(ValueError, match="read-only"):
        own.model.mesh_vert[0] = 1.0
    model.mesh_vert[0] = model.mesh_vert[0]  # the given one stays writable
