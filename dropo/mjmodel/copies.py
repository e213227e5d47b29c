"""Copies of a model whose numbers can be put back, which is quicker than to copy it anew."""

import copy
from typing import Any

import mujoco
import numpy as np

LARGE = (
    "bvh_depth",
    "bvh_child",
    "bvh_nodeid",
    "bvh_aabb",
    "oct_depth",
    "oct_child",
    "oct_aabb",
    "oct_coeff",
    "mesh_vert",
    "mesh_polymapadr",
    "mesh_polymapnum",
    "mesh_normal",
    "mesh_texcoord",
    "mesh_face",
    "mesh_facenormal",
    "mesh_facetexcoord",
    "mesh_graph",
    "mesh_polynormal",
    "mesh_polyvertadr",
    "mesh_polyvertnum",
    "mesh_polyvert",
    "mesh_polymap",
    "tex_data",
)
"""Arrays of what makes up meshes and pictures, which no copy changes."""
FLAGS = ("flg_gravcomp", "flg_surfacevel", "flg_adhesion")
"""What MuJoCo notes of a model's numbers, where its version does."""


class ModelCopy:
    """A copy of a model that is changed, and made equal to the model again.

    Parameters
    ----------
    model : MjModel
        The model.

    Attributes
    ----------
    model : MjModel
        The copy. What makes up meshes and pictures cannot be written there.
    """

    def __init__(self, model: mujoco.MjModel):
        self.model = copy.copy(model)
        self._of = model
        self._arrays: list[tuple[Any, Any]] | None = None
        self._numbers: list[tuple[Any, Any, str]] = []
        for name in LARGE:
            array = getattr(self.model, name, None)
            if array is not None:
                array.flags.writeable = False

    def restore(self) -> None:
        """Write all numbers of the model, as they are now, into the copy."""
        if self._arrays is None:
            self._arrays = self._find()
        for own, other in self._arrays:
            own[...] = other
        for owner, other, name in self._numbers:
            setattr(owner, name, getattr(other, name))

    def _find(self) -> list[tuple[Any, Any]]:
        """The arrays of the copy and of the model that may differ; single numbers are noted."""
        arrays = []
        owners = [(self.model, self._of)]
        owners += [(getattr(self.model, one), getattr(self._of, one)) for one in ("opt", "stat")]
        for own, other in owners:
            for name in dir(own):
                value: Any = None if name.startswith("_") or name in LARGE else getattr(own, name)
                if isinstance(value, np.ndarray):
                    if value.size:
                        arrays.append((value, getattr(other, name)))
                elif isinstance(value, int | float) and (own is not self.model or name in FLAGS):
                    self._numbers.append((own, other, name))
        return arrays
