"""What is only seen is dropped, and nothing else: every other number is the same, bit for bit."""

import mujoco
import numpy as np
import pytest

from benchmarks.meshes import JOINTS, write_arm, write_link
from dropo.mjmodel.copies import FLAGS, LARGE
from dropo.mjmodel.visuals import (
    VisualSettings,
    lost_shapes,
    only_seen,
    without_visuals,
)

ALL = VisualSettings(least=0)
CHANGED = {
    "mesh_vertadr",
    "mesh_vertnum",
    "mesh_normaladr",
    "mesh_normalnum",
    "mesh_texcoordadr",
    "mesh_texcoordnum",
    "mesh_faceadr",
    "mesh_facenum",
    "mesh_polyadr",
    "mesh_polynum",
    "mesh_bvhadr",
    "mesh_bvhnum",
    "mesh_octadr",
    "mesh_octnum",
    "mesh_graphadr",
    "hfield_adr",
    "hfield_nrow",
    "hfield_ncol",
    "hfield_data",
    "tex_adr",
    "tex_height",
    "tex_width",
    *LARGE,
}
BLOCKS = {
    "vert": ("mesh_vert",),
    "normal": ("mesh_normal",),
    "face": ("mesh_face", "mesh_facenormal", "mesh_facetexcoord"),
    "poly": ("mesh_polynormal", "mesh_polyvertnum"),
    "bvh": ("bvh_depth", "bvh_child", "bvh_nodeid", "bvh_aabb"),
}
"""What belongs to a mesh, by the name of its address and number."""

MIXED = """<mujoco><asset>
  <mesh name="shell" file="link.stl"/><mesh name="core" file="link.stl" scale="0.9 0.9 0.9"/>
  <mesh name="spare" file="link.stl"/><mesh name="paired" file="link.stl" scale="0.5 0.5 0.5"/>
  <hfield name="hills" nrow="20" ncol="30" size="1 1 0.2 0.1"/>
  <hfield name="ground" nrow="10" ncol="15" size="1 1 0.2 0.1"/>
  <texture name="grain" type="2d" builtin="checker" width="64" height="64"/>
  <material name="paint" texture="grain"/></asset>
<worldbody>
  <geom name="hills" type="hfield" hfield="hills" contype="0" conaffinity="0"/>
  <geom name="ground" type="hfield" hfield="ground"/>
  <body name="one" pos="0 0 0.2"><freejoint/>
    <geom name="seen" type="mesh" mesh="shell" contype="0" conaffinity="0" material="paint"/>
    <geom name="core" type="mesh" mesh="core" mass="0"/></body>
  <body name="two" pos="0.4 0 0.2"><freejoint/>
    <geom name="paired" type="mesh" mesh="paired" contype="0" conaffinity="0"/></body>
</worldbody>
<contact><pair geom1="paired" geom2="ground"/></contact>
<sensor>{sensor}</sensor></mujoco>"""


def arrays(model):
    """The names of all arrays of a model."""
    public = [name for name in dir(model) if not name.startswith("_")]
    return [name for name in public if isinstance(getattr(model, name), np.ndarray | bytes)]


def mixed(folder, sensor=""):
    """A model with meshes and height fields that are seen, unused, colliding and in a pair."""
    write_link(folder / "link.stl", 400)
    path = folder / "mixed.xml"
    path.write_text(MIXED.format(sensor=sensor))
    return mujoco.MjModel.from_xml_path(str(path))


def parts_of(model, mesh, owner, field):
    """The rows of a field that belong to each polygon or vertex of a mesh."""
    first = getattr(model, f"mesh_{owner}adr")[mesh]
    rows = slice(first, first + getattr(model, f"mesh_{owner}num")[mesh])
    starts = getattr(model, f"{field}adr")[rows]
    counts = getattr(model, f"{field}num")[rows]
    data = getattr(model, field)
    return [data[at : at + count].tolist() for at, count in zip(starts, counts, strict=True)]


@pytest.mark.parametrize("looks", ["seen", "colliding"])
def test_all_other_numbers_are_the_same(tmp_path, looks):
    """Masses and inertias, which come from the meshes, among them; and what is dropped is gone."""
    path = write_arm(tmp_path, 400, looks)
    text = path.read_text().replace("<asset>", "<visual><map znear='0.02'/></visual><asset>")
    path.write_text(text.replace('name="link2"', 'name="link2" gravcomp="0.5"'))
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.flg_gravcomp
    assert (model.body_mass[1:] > 1).all()  # not of the cores, which have none
    smaller = without_visuals(model, ALL)
    for name in sorted(set(arrays(model)) - CHANGED):
        value = getattr(model, name)
        if isinstance(value, bytes):
            assert getattr(smaller, name) == value
        else:
            np.testing.assert_array_equal(getattr(smaller, name), value, err_msg=name)
    for part in ("opt", "stat", "vis"):
        assert repr(getattr(smaller, part)) == repr(getattr(model, part))
    for name in ("timestep", "integrator", "disableflags", "gravity", "tolerance"):
        np.testing.assert_array_equal(getattr(smaller.opt, name), getattr(model.opt, name))
    for name in FLAGS:
        assert getattr(smaller, name) == getattr(model, name)
    assert smaller.stat.meaninertia == model.stat.meaninertia > 0
    assert smaller.ntexdata == 0 < model.ntexdata
    kept = model.nmeshvert if looks == "colliding" else 0
    assert smaller.nmeshvert == kept < 1 + model.nmeshvert
    assert len(lost_shapes(smaller)) == (0 if kept else JOINTS)


def test_what_collides_keeps_its_shape(tmp_path):
    """Meshes that collide or are in a pair keep all that makes them up, and height fields their
    heights; those that are seen or unused lose it.
    """
    model = mixed(tmp_path)
    smaller = without_visuals(model, ALL)
    for name in ("shell", "core", "spare", "paired"):
        i = model.mesh(name).id
        for part, fields in BLOCKS.items():
            starts, counts = f"mesh_{part}adr", f"mesh_{part}num"
            if name in ("shell", "spare"):
                assert getattr(smaller, counts)[i] == 0
                continue
            assert getattr(smaller, counts)[i] == getattr(model, counts)[i] > 0
            for field in fields:
                old, new = (
                    getattr(one, field)[getattr(one, starts)[i] :][: getattr(one, counts)[i]]
                    for one in (model, smaller)
                )
                np.testing.assert_array_equal(new, old, err_msg=f"{name} {field}")
    for field, owner in (("mesh_polyvert", "poly"), ("mesh_polymap", "vert")):
        for name in ("core", "paired"):
            pieces = [parts_of(one, one.mesh(name).id, owner, field) for one in (model, smaller)]
            assert pieces[0] == pieces[1]
            assert len(pieces[0]) > 100
    assert smaller.hfield_nrow.tolist() == [0, 10]
    np.testing.assert_array_equal(smaller.hfield_data, model.hfield_data[20 * 30 :])
    assert [model.geom(i).name for i in only_seen(model)] == ["hills", "seen"]
    assert [smaller.geom(i).name for i in lost_shapes(smaller)] == ["hills", "seen"]


def test_bodies_fall_on_the_same_bits(tmp_path):
    """Contacts of meshes, height fields and pairs are those of the whole model."""
    model = mixed(tmp_path)
    states = []
    contacts = 0
    for one in (model, without_visuals(model, ALL)):
        data = mujoco.MjData(one)
        found = []
        for _ in range(300):
            mujoco.mj_step(one, data)
            contacts += data.ncon
            found.append([*data.qpos, *data.qvel])
        states.append(found)
    assert contacts > 100
    np.testing.assert_array_equal(states[1], states[0])


@pytest.mark.parametrize(
    "sensor",
    [
        '<distance geom1="seen" geom2="paired" cutoff="1"/>',
        '<distance body1="one" geom2="paired" cutoff="1"/>',
    ],
)
def test_sensors_that_see_keep_all_shapes(tmp_path, sensor):
    """A distance is measured to geoms that collide with nothing; textures go all the same."""
    model = mixed(tmp_path, sensor)
    smaller = without_visuals(model, ALL)
    assert len(only_seen(model)) == 0
    assert smaller.nmeshvert == model.nmeshvert
    assert smaller.ntexdata == 0


def test_small_models_stay_themselves(tmp_path):
    """Below the size that is worth it, the model is not copied; control: beyond it, it is."""
    model = mixed(tmp_path)
    assert without_visuals(model) is model
    assert without_visuals(model, ALL) is not model


def test_an_unknown_format_keeps_the_model(tmp_path, monkeypatch):
    """Where arrays are in another order than known, the whole model is used."""
    from dropo.mjmodel import visuals

    model = mixed(tmp_path)
    known = visuals._fields()
    turned = dict(reversed(known.items()))
    monkeypatch.setattr(visuals, "_fields", lambda: turned)
    assert without_visuals(model, ALL) is model
