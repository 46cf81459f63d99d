"""Compiled systems out of files."""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError, ModelError, TwistaxError
from ...system import System
from ..backends import Backend
from ..dynamics import Dynamics, compile
from . import version
from .plain import PlainReader
from .saved import FORMAT, JSON, keys
from .tree import read_nodes, read_only

__all__ = ["load"]


def load(path: str | Path, *, backend: Backend | Literal["auto"] | None = None) -> Dynamics:
    """A compiled system from a file that `Dynamics.save` wrote.

    Its expressions have the keys they had, and its functions give the same numbers on the same machine, to the last
    bit. Nothing in a file is run. Nodes, groups and backends of your own are found by the names of their module and
    class: import what defines them first.

    Args:
        backend: another one than it was compiled with.
    Raises:
        InputError: no such file, no file of this kind, a damaged one, or one of another format; it names the path and
            the versions.
        ModelError: a class that is not known here, or that has changed since.
    """
    place = str(path)
    try:
        with zipfile.ZipFile(path) as archive:
            content = json.loads(archive.read(JSON))
            _check_version(place, content)
            count = content["arrays"]
            arrays = read_only(_array(archive.read(f"arrays/{k}.npy")) for k in range(count))
        system, options = _system(content, arrays)
        if backend is not None:
            options["backend"] = backend
        dynamics = compile(system, **options)
        if keys(system) != content["keys"]:
            raise ModelError(
                f"the expressions of {place!r} read back as others: a class of theirs has changed since twistax "
                f"{content['twistax']} saved them.\n  fix: load the file with that version"
            )
    except FileNotFoundError:
        raise InputError(f"there is no file {place!r}") from None
    except OSError as error:
        raise InputError(f"cannot load {place!r}: {error}") from None
    except TwistaxError:
        raise
    except MemoryError:
        raise InputError(f"{place!r} is damaged, or too large for the memory there is") from None
    except (zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, EOFError) as error:
        raise InputError(f"{place!r} is not a whole file of a saved system: {error}") from None
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, NotImplementedError, RuntimeError) as error:
        raise InputError(f"{place!r} is no saved system, or damaged: {type(error).__name__}: {error}") from None
    return dynamics


def _system(content: dict[str, Any], arrays: list[NDArray[Any]]) -> tuple[System, dict[str, Any]]:
    """The system, and how it was compiled."""
    nodes: list[Any] = read_nodes(content["nodes"], arrays)
    states = {nodes[place].name: nodes[place] for place in content["states"]}
    named = {kind: {n: nodes[place] for n, place in content[kind]} for kind in ("rates", "outputs", "constraints")}
    system = System(
        rates={states[name]: rate for name, rate in named["rates"].items()},
        outputs=named["outputs"],
        constraints=named["constraints"],
        controls=[nodes[place] for place in content["controls"]],
        parameters=[nodes[place] for place in content["parameters"]],
    )
    reader, compiled = PlainReader(arrays, lambda place: nodes[place]), content["compiled"]
    bake = {name: reader.read(value) for name, value in compiled["bake"]}
    return system, {"outputs": compiled["outputs"], "bake": bake, "backend": reader.read(compiled["backend"])}


def _check_version(place: str, content: Any) -> None:
    if content["format"] != FORMAT:
        raise InputError(
            f"{place!r} was saved by twistax {content['twistax']} in format {content['format']}; this is twistax "
            f"{version()}, which reads format {FORMAT}.\n  fix: load it with twistax {content['twistax']}, or save the "
            "system again with this one"
        )


def _array(data: bytes) -> NDArray[Any]:
    found: NDArray[Any] = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    return found
