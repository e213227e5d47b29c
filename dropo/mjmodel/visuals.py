"""What of a model is only seen: large, copied with it, and of no effect on any motion.

The elements keep their numbers: a geom of a mesh that is only seen keeps its place, size, mass and
name, and its mesh has no vertices. Everything that is found by index in one model is so in both.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from dropo.core.services.validation import Array
from dropo.mjmodel.copies import FLAGS

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class VisualSettings:
    """When a model is worth a smaller one.

    Attributes
    ----------
    least : int
        The bytes of vertices, faces and pixels from which what is only seen is dropped.
    """

    least: int = 1 << 20


SETTINGS = VisualSettings()

_KINDS = mujoco.mjtSensor
_SEES = [
    int(getattr(_KINDS, f"mjSENS_{name}"))
    for name in ("RANGEFINDER", "GEOMDIST", "GEOMNORMAL", "GEOMFROMTO", "TACTILE", "PLUGIN", "USER")
    if hasattr(_KINDS, f"mjSENS_{name}")
]
"""Sensors that may measure what no contact is computed of."""

_ROWS = (
    ("nmesh", "mesh_vertadr", "mesh_vertnum", "nmeshvert"),
    ("nmesh", "mesh_normaladr", "mesh_normalnum", "nmeshnormal"),
    ("nmesh", "mesh_texcoordadr", "mesh_texcoordnum", "nmeshtexcoord"),
    ("nmesh", "mesh_faceadr", "mesh_facenum", "nmeshface"),
    ("nmesh", "mesh_polyadr", "mesh_polynum", "nmeshpoly"),
    ("nmesh", "mesh_bvhadr", "mesh_bvhnum", "nbvh"),
    ("nmesh", "mesh_octadr", "mesh_octnum", "noct"),
    ("nmesh", "mesh_graphadr", "", "nmeshgraph"),
    ("nmeshpoly", "mesh_polyvertadr", "mesh_polyvertnum", "nmeshpolyvert"),
    ("nmeshvert", "mesh_polymapadr", "mesh_polymapnum", "nmeshpolymap"),
    ("nhfield", "hfield_adr", "", "nhfielddata"),
    ("ntex", "tex_adr", "", "ntexdata"),
)
"""The number of owners, where the rows of each begin, how many they are, and the number of all."""
_CUT = {rows for *_, rows in _ROWS} | {"nbvhstatic"}
"""The sizes that become smaller."""
_EMPTIED = {
    "nhfield": ("hfield_nrow", "hfield_ncol"),
    "ntex": ("tex_height", "tex_width"),
}
"""What else is 0 of an element without rows."""
_STRUCTS = ("opt", "vis", "stat", *FLAGS)
"""What of a model is in no array."""
_ALIGNED = 64
"""The bytes to which MuJoCo aligns each array."""
_SIZES = 20
"""Where the sizes begin in MuJoCo's binary format, behind five integers."""


def only_seen(model: mujoco.MjModel) -> NDArray[np.int64]:
    """List the geoms of meshes and height fields that no contact and no sensor reaches.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    (g,) array of int
        None where something of the model may look at any geom, as a range finder does.
    """
    if _may_see_all(model):
        return np.zeros(0, dtype=np.int64)
    alone = (model.geom_contype == 0) & (model.geom_conaffinity == 0)
    alone[model.pair_geom1] = False
    alone[model.pair_geom2] = False
    kinds = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD)
    return np.flatnonzero(alone & np.isin(model.geom_type, [int(kind) for kind in kinds]))


def without_visuals(model: mujoco.MjModel, settings: VisualSettings = SETTINGS) -> mujoco.MjModel:
    """Drop the meshes, height fields and textures that are only seen.

    Parameters
    ----------
    model : MjModel
        The compiled model, which stays as it is.
    settings : VisualSettings

    Returns
    -------
    MjModel
        Every other number is the same, bit for bit; the model itself where it has little to drop,
        and with a version of MuJoCo whose binary format is another.
    """
    dropped = _dropped(model)
    if _bytes(model, dropped) < settings.least:
        return model
    fields = _fields()
    cut = _cut(model, dropped, fields)
    content = _binary(model, cut, fields)
    if content is None:
        return model
    try:
        smaller = mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": content})
    except (ValueError, mujoco.FatalError):
        return model
    _copy_numbers(smaller, model)
    same = all(
        np.array_equal(_bytes_of(smaller, name), _bytes_of(model, name))
        for name in fields
        if name not in cut
    )
    return smaller if same else model


def _copy_numbers(to: Any, of: Any) -> None:
    """Write the numbers of a model that are in no array of it: options, statistics, flags."""
    for name in dir(of):
        if name.startswith("_") or (isinstance(of, mujoco.MjModel) and name not in _STRUCTS):
            continue
        value = getattr(of, name)
        if isinstance(value, np.ndarray):
            getattr(to, name)[...] = value
        elif isinstance(value, int | float):
            setattr(to, name, value)
        elif not callable(value):
            _copy_numbers(getattr(to, name), value)


def lost_shapes(model: mujoco.MjModel) -> NDArray[np.int64]:
    """List the geoms whose meshes or height fields were dropped.

    Parameters
    ----------
    model : MjModel
        The compiled model.

    Returns
    -------
    (g,) array of int
    """
    lost = np.zeros(model.ngeom, dtype=bool)
    for kind, count in (("MESH", model.mesh_vertnum), ("HFIELD", model.hfield_nrow)):
        of_kind = model.geom_type == int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"))
        lost[of_kind] = count[model.geom_dataid[of_kind]] == 0
    return np.flatnonzero(lost)


def _dropped(model: mujoco.MjModel) -> dict[str, Mask]:
    """Which meshes, height fields and textures are dropped."""
    found = {"ntex": np.ones(model.ntex, dtype=bool)}
    if _may_see_all(model):
        sizes = {"nmesh": model.nmesh, "nhfield": model.nhfield}
        return {**found, **{size: np.zeros(count, dtype=bool) for size, count in sizes.items()}}
    kept = np.ones(model.ngeom, dtype=bool)
    kept[only_seen(model)] = False
    sites = getattr(model, "site_dataid", np.zeros(0, dtype=np.int32))
    for size, kinds in (("nmesh", ("MESH", "SDF")), ("nhfield", ("HFIELD",))):
        numbers = [int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")) for kind in kinds]
        used = model.geom_dataid[kept & np.isin(model.geom_type, numbers)]
        needed = np.zeros(getattr(model, size), dtype=bool)
        needed[used[used >= 0]] = True
        if size == "nmesh":
            needed[sites[sites >= 0]] = True
        found[size] = ~needed
    return found


def _may_see_all(model: mujoco.MjModel) -> bool:
    """Whether something of a model may look at any geom."""
    looking = np.isin(model.sensor_type, _SEES).any()
    return bool(model.nflex or model.nplugin or looking)


def _bytes(model: mujoco.MjModel, dropped: dict[str, Mask]) -> int:
    """The bytes of vertices, faces, heights and pixels that are dropped."""
    meshes = dropped["nmesh"]
    vertices = int(model.mesh_vertnum[meshes].sum())
    faces = int(model.mesh_facenum[meshes].sum())
    heights = int((model.hfield_nrow * model.hfield_ncol)[dropped["nhfield"]].sum())
    return 12 * (vertices + faces) + 4 * heights + int(model.ntexdata)


def _fields() -> dict[str, str]:
    """The arrays of MjModel in their order in memory, each with the size that counts its rows."""
    from mujoco.introspect.structs import STRUCTS

    found = {}
    for field in STRUCTS["mjModel"].fields:
        extent = getattr(field, "array_extent", None)
        if extent:
            found[field.name] = str(extent[0])
    return found


def _counts(model: mujoco.MjModel, address: str, number: str) -> NDArray[np.int64]:
    """How many rows each owner has."""
    if number:
        return np.asarray(getattr(model, number), dtype=np.int64)
    if address == "hfield_adr":
        return np.asarray(model.hfield_nrow, dtype=np.int64) * model.hfield_ncol
    if address == "tex_adr":
        return np.asarray(model.tex_height, dtype=np.int64) * model.tex_width * model.tex_nchannel
    # the graph of a convex hull says how many vertices and faces it has
    found = np.zeros(model.nmesh, dtype=np.int64)
    for i, start in enumerate(model.mesh_graphadr.tolist()):
        if start >= 0:
            vertices, faces = model.mesh_graph[start : start + 2].tolist()
            found[i] = 2 + 3 * vertices + 6 * faces
    return found


def _cut(
    model: mujoco.MjModel, dropped: dict[str, Mask], fields: dict[str, str]
) -> dict[str, Array]:
    """The arrays that change, by name."""
    gone = dict(dropped)
    cut: dict[str, Array] = {}
    for owners, address, number, size in _ROWS:
        own = gone[owners]
        starts = np.asarray(getattr(model, address), dtype=np.int64)
        counts = _counts(model, address, number)
        gone[size] = _rows_of(own & (starts >= 0), starts, counts, getattr(model, size))
        before = np.concatenate([[0], np.cumsum(~gone[size])])  # the rows kept before each
        moved = np.where(starts >= 0, before[np.maximum(starts, 0)], starts)
        left = counts
        if owners in dropped:
            moved[own & (starts >= 0)] = 0
            left = np.where(own, 0, counts)
        changed = {address: moved}
        if number:
            changed[number] = left
        for name, numbers in changed.items():
            cut[name] = numbers.astype(getattr(model, name).dtype)
        if size == "nbvh":
            bodies = model.body_bvhadr
            cut["body_bvhadr"] = np.where(bodies >= 0, before[bodies], bodies).astype(bodies.dtype)
            gone["nbvhstatic"] = gone[size][: model.nbvhstatic]
    for owners, names in _EMPTIED.items():
        for name in names:
            cut[name] = np.where(gone[owners], 0, getattr(model, name)).astype(np.int32)
    for name, size in fields.items():
        if size in _CUT:
            cut[name] = cut.get(name, getattr(model, name))[~gone[size]]
    return cut


def _rows_of(own: Mask, starts: NDArray[np.int64], counts: NDArray[np.int64], rows: int) -> Mask:
    """Which of all rows belong to some of their owners."""
    if len(own) and own.all() and counts.sum() == rows:
        return np.ones(rows, dtype=bool)
    edges = np.zeros(rows + 1, dtype=np.int64)
    holding = own & (counts > 0)
    np.add.at(edges, starts[holding], 1)
    np.add.at(edges, starts[holding] + counts[holding], -1)
    return np.cumsum(edges)[:-1] > 0


def _binary(model: mujoco.MjModel, cut: dict[str, Array], fields: dict[str, str]) -> bytes | None:
    """MuJoCo's binary format of a model with some of its arrays changed; None of another format.

    Options and statistics are those of an empty model.
    """
    names = _size_names()
    empty = mujoco.MjModel.from_xml_string("<mujoco/>")
    written = np.zeros(mujoco.mj_sizeModel(empty), dtype=np.uint8)
    mujoco.mj_saveModel(empty, None, written)
    own = np.array([getattr(empty, name) for name in names], dtype=np.int64)
    structs = _SIZES + own.nbytes
    arrays = len(written) - sum(_bytes_of(empty, name).size for name in fields)
    slack = model.nbuffer - _aligned(_bytes_of(model, name).size for name in fields)
    understood = (
        arrays >= structs
        and np.array_equal(written[_SIZES:structs], own.view(np.uint8))
        and 0 <= slack < _ALIGNED
    )
    if not understood:
        return None
    sizes = np.array([getattr(model, name) for name in names], dtype=np.int64)
    parts = [_bytes_of(model, name) if name not in cut else _raw(cut[name]) for name in fields]
    for name, size in fields.items():
        if name in cut and size in names:
            sizes[names.index(size)] = len(cut[name])
    sizes[names.index("nbuffer")] = _aligned(part.size for part in parts) + slack
    head = [written[:_SIZES], sizes.view(np.uint8), written[structs:arrays]]
    return np.concatenate([*head, *parts]).tobytes()


def _size_names() -> list[str]:
    """The sizes of MjModel in their order."""
    from mujoco.introspect.structs import STRUCTS

    names = [field.name for field in STRUCTS["mjModel"].fields]
    return names[: names.index("nbuffer") + 1]


def _aligned(lengths: Iterable[int]) -> int:
    """The bytes of a buffer of arrays of so many bytes."""
    end = 0
    for length in lengths:
        end += -end % _ALIGNED + length
    return end


def _raw(array: Array) -> NDArray[np.uint8]:
    """The bytes of an array."""
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8)


def _bytes_of(model: mujoco.MjModel, name: str) -> NDArray[np.uint8]:
    """The bytes of an array of a model."""
    value = getattr(model, name)
    if isinstance(value, bytes):
        return np.frombuffer(value, dtype=np.uint8)
    return _raw(value)
