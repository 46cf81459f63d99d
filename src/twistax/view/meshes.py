"""Solids from files of triangles: STL, OBJ and DAE, read by trimesh (extra `view`) when they are drawn."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ..checks import reals, short
from ..errors import InputError, ModelError
from .shapes import Shape


@dataclasses.dataclass(frozen=True, eq=False)
class Mesh(Shape):
    """A solid made of triangles, from a file or as numbers.

    Attributes:
        source: path of a file that trimesh reads, such as STL, OBJ or DAE; or a pair of vertices (n, 3) in m and
            triangles (m, 3) of vertex indices.
        at, color, opacity: as for `Shape`.
        scale: the factor of the vertices, a number or three, such as 0.001 for a file in mm.
    Raises: InputError when the file is drawn: it does not exist, cannot be read, or has no triangles. ModelError when
        it is drawn and trimesh is not installed.
    """

    source: Any
    scale: Any = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        scale = reals("Mesh: scale", self.scale, InputError)
        if scale.shape not in ((), (3,)) or not np.isfinite(scale).all() or not np.all(scale):
            raise InputError(f"Mesh expects scale as a number or three other than 0, got {short(self.scale)}")
        if not isinstance(self.source, (str, Path)):
            corners = reals("Mesh: corners", self.source[0], InputError)
            faces = np.asarray(self.source[1])
            inside = faces.ndim == 2 and faces.shape[1] == 3 and len(faces) and 0 <= faces.min() <= faces.max()
            if corners.ndim != 2 or corners.shape[1] != 3 or not inside or faces.max() >= len(corners):
                raise InputError(
                    "Mesh expects vertices (n, 3) and triangles (m, 3) of vertex indices, got shapes "
                    f"{corners.shape} and {faces.shape}"
                )

    @functools.cached_property
    def _mesh(self) -> tuple[Array, Array]:
        corners, faces = _read(Path(self.source)) if isinstance(self.source, (str, Path)) else self.source
        # A mirror image would turn its triangles inside out.
        scaled = np.asarray(corners, dtype=np.float64) * self.scale
        mirrored = np.prod(np.broadcast_to(self.scale, (3,))) < 0.0
        return scaled, np.asarray(faces)[:, ::-1] if mirrored else np.asarray(faces)

    def mesh(self) -> tuple[Array, Array]:
        return self._mesh


def _read(path: Path) -> tuple[Array, Array]:
    try:
        import trimesh
    except ImportError as error:
        raise ModelError(f"meshes need trimesh ({error}).\n  fix: pip install 'twistax[view]'") from None
    try:
        solid: Any = trimesh.load(path, force="mesh", process=False)
    except Exception as error:  # its readers raise errors of many kinds
        raise InputError(f"Mesh cannot read {str(path)!r}: {error}") from None
    if not len(getattr(solid, "faces", ())):
        raise InputError(f"Mesh: {str(path)!r} has no triangles")
    return np.asarray(solid.vertices), np.asarray(solid.faces)
