"""Compiled systems into files; `loaded.py` reads them.

A file is a zip archive: `system.json` holds the expressions as a list of nodes, the declarations and how the system was
compiled, `arrays/0.npy`, ... the arrays. What is saved is the tree, not the code made of it: it is small, says what the
system means, holds nothing that runs when it is read, and code is made anew for the machine that loads it.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...expr import Expr
from ...system import System
from ..functions import Functions
from . import version
from .plain import PlainWriter
from .tree import write_nodes

__all__ = ["FORMAT", "JSON", "keys", "save"]

#: Raised whenever a file of the old form would be read wrongly.
FORMAT = 2

#: The member of the archive that says everything but the arrays.
JSON = "system.json"
_FIXED_TIME = (1980, 1, 1, 0, 0, 0)  # equal systems give equal files


def save(dynamics: Functions, path: str | Path) -> None:
    """What `Dynamics.save` does.

    Raises:
        ModelError: a field that has no plain form.
        InputError: the file cannot be written.
    """
    arrays: list[NDArray[Any]] = []
    content = _content(dynamics, arrays)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        _add(archive, JSON, json.dumps(content, allow_nan=False).encode())
        for k, array in enumerate(arrays):
            _add(archive, f"arrays/{k}.npy", _npy(array))
    target = Path(path)
    beside = target.parent / f"{target.name}.{os.getpid()}.part"
    try:
        # Written beside, then moved: a file is whole or not there.
        beside.write_bytes(buffer.getvalue())
        beside.replace(target)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise InputError(f"cannot save to {str(target)!r}: {error}") from None


def _content(dynamics: Functions, arrays: list[NDArray[Any]]) -> dict[str, Any]:
    system = dynamics.system
    named: dict[str, dict[str, Expr]] = {
        "rates": system.rates,
        "outputs": system.outputs,
        "constraints": dict(system.constraints),
    }
    leaves = {"states": system.states, "controls": system.controls, "parameters": system.parameters}
    roots = [leaf for group in leaves.values() for leaf in group]
    nodes, places = write_nodes([*roots, *(e for group in named.values() for e in group.values())], arrays)
    writer = PlainWriter(arrays, lambda node: places[id(node)])
    compiled = {
        "outputs": list(dynamics.families["outputs"]),
        "bake": [[name, writer.write(value, f"bake[{name!r}]")] for name, value in dynamics.baked.items()],
        "backend": writer.write(dynamics.backend, "the backend"),
    }
    return {
        "format": FORMAT,
        "twistax": version(),
        "nodes": nodes,
        **{kind: [places[id(leaf)] for leaf in own] for kind, own in leaves.items()},
        **{kind: [[name, places[id(e)]] for name, e in own.items()] for kind, own in named.items()},
        "compiled": compiled,
        "keys": keys(system),
        "arrays": len(arrays),
    }


def keys(system: System) -> list[str]:
    """The structure of all that is computed, in order."""
    return [e.key() for own in (system.rates, system.outputs, system.constraints) for e in own.values()]


def _add(archive: zipfile.ZipFile, name: str, data: bytes) -> None:
    info = zipfile.ZipInfo(name, _FIXED_TIME)
    info.compress_type = zipfile.ZIP_DEFLATED
    archive.writestr(info, data)


def _npy(array: NDArray[Any]) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()
