"""A functional mock-up unit as a file: an archive of C source, a library compiled for this machine, and the model
description.
"""

from __future__ import annotations

import hashlib
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import jax
import numpy as np
from numpy import ndarray as Array

from ...checks import number, path_of, short
from ...errors import InputError, ModelError
from ...progress import watching
from ...scalar.targets.c import c_type
from ..export.c99 import check_name
from ..export.c_code import mark, numbers
from ..functions import Functions
from ..inputs import Values, read_values
from .description import build_description, model_description
from .functions import UnitFunctions
from .variables import VariableList

_REAL = c_type(np.dtype(float))
#: Every file of an archive has this date, so that equal units are equal bytes.
_DATE = (1980, 1, 1, 0, 0, 0)
#: Where the token goes, which is made of the rest of the source.
_TOKEN = "TOKEN_OF_THE_UNIT"
#: How far a state may be from its group.
_OFF = 1e-6


@watching("export")
def write_unit(
    functions: Functions,
    path: str | Path,
    x0: Values | None,
    u: Values | None,
    params: Values | None,
    *,
    advance: Callable[..., Mapping[str, Any]] | None,
    dt: float,
    compiler: str | None,
) -> Path:
    """Implements `Dynamics.to_fmu`, which documents the arguments."""
    target = path_of("path", path)
    if target.suffix != ".fmu":
        raise InputError(f"to_fmu: path expects a file name that ends in .fmu, got {str(path)!r}")
    name = re.sub(r"[^A-Za-z0-9_]", "_", target.stem)
    check_name(name)
    number("dt", dt, "above zero", lambda size: 0.0 < size < np.inf)
    of_unit = UnitFunctions(functions, advance)
    starts = of_unit.flat(*_starts(functions, x0, u, params))
    variables = VariableList(functions, of_unit, starts)
    step = None if advance is None else float(dt)
    source = _source(name, of_unit, variables, starts, step)
    token = "{" + hashlib.sha256(source.encode()).hexdigest()[:32] + "}"
    source = source.replace(_TOKEN, token)
    files = {
        "modelDescription.xml": model_description(name, token, variables, step),
        f"sources/{name}.c": source,
        "sources/buildDescription.xml": build_description(name),
    }
    content = {file: text.encode() for file, text in files.items()}
    if compiler is not None:
        content |= _compiled(name, source, compiler)
    _write(target, content)
    return target


def _starts(
    functions: Functions, x0: Values | None, u: Values | None, params: Values | None
) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array]]:
    """States, controls and parameters at the beginning: as passed, else as their leaves say, else zero.

    Raises:
        InputError: unknown names, other shapes, no finite numbers, no elements of their groups.
        ModelError: a parameter without a value.
    """
    chosen = []
    with jax.enable_x64(True):
        for kind, leaves, values in (
            ("x0", functions.states, x0),
            ("u", functions.controls, u),
            ("params", functions.parameters, params),
        ):
            passed = read_values(kind, leaves, values, np.dtype(float), on_host=True)
            chosen.append({leaf.name: _start(kind, leaf, passed.get(leaf.name)) for leaf in leaves})
    return chosen[0], chosen[1], chosen[2]


def _start(kind: str, leaf: Any, passed: Any) -> Array:
    """The value of a leaf at the beginning."""
    if passed is None and kind == "params":
        passed = leaf.value
        if passed is None:
            raise ModelError(
                f"to_fmu: the parameter {leaf.name!r} has no value, but every variable of a unit needs one.\n"
                f"  fix: pass params={{{leaf.name!r}: ...}}"
            )
    if passed is not None:
        value = np.asarray(passed, float)
        group = getattr(leaf, "group", None)
        if not np.isfinite(value).all():
            raise InputError(f"to_fmu: {kind}[{leaf.name!r}] expects finite numbers, got {short(value)}")
        if group is not None and not group.flat and not group.known_defect(value) < _OFF:
            raise InputError(f"to_fmu: {kind}[{leaf.name!r}] is not an element of {group.name}\n  fix: {group.remedy}")
        return value
    values = [a for a in (getattr(leaf, "initial", None), leaf.guess) if a is not None and np.shape(a) == leaf.shape]
    finite = [np.asarray(a, float) for a in values if np.isfinite(a).all()]
    group = getattr(leaf, "group", None)
    at_rest = np.zeros(leaf.shape) if group is None or group.flat else np.asarray(group.identity(np.dtype(float)))
    return finite[0] if finite else at_rest


def _source(
    name: str, of_unit: UnitFunctions, variables: VariableList, starts: Sequence[Array], step: float | None
) -> str:
    """The text of the C file, with a mark where its token goes."""
    written = of_unit.written()
    tables = dict.fromkeys(table for _, function, _ in written for table in function.program.tables)
    texts = [numbers(table.name, table.numbers(np.dtype(float)), _REAL) for table in tables]
    texts += [f"{head}\n{{\n{text}}}\n" for head, _, text in written]
    x, u, p = (", ".join(_REAL.literal(v) for v in values) or "0" for values in starts)
    return Template(Path(__file__).with_name("fmu.c.in").read_text()).substitute(
        mark=mark(),
        name=name,
        states=len(starts[0]),
        inputs=len(starts[1]),
        parameters=len(starts[2]),
        outputs=sum(v.causality == "output" and v.start is None for v in variables.all),
        functions="\n".join(texts),
        start_x=x,
        start_u=u,
        start_p=p,
        has_steps=int(step is not None),
        step=_REAL.literal(step or 1.0),
        token=_TOKEN,
    )


def _compiled(name: str, source: str, compiler: str) -> dict[str, bytes]:
    """The library for this machine by its place in the archive.

    Raises:
        ModelError: the compiler is not there, or refuses the source.
    """
    program = shutil.which(compiler)
    if program is None:
        raise ModelError(
            f"to_fmu: there is no C compiler {compiler!r}.\n"
            "  fix: install it, name another one, or pass compiler=None for a unit that contains only sources"
        )
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
    system, suffix = {"darwin": ("darwin", "dylib"), "win32": ("windows", "dll")}.get(sys.platform, ("linux", "so"))
    with tempfile.TemporaryDirectory() as folder:
        file, library = Path(folder) / f"{name}.c", Path(folder) / f"{name}.{suffix}"
        file.write_text(source, encoding="ascii")
        flags = ["-std=c99", "-O1", "-shared", "-fPIC", "-fvisibility=hidden"]
        command = [program, *flags, str(file), "-o", str(library), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise ModelError(f"to_fmu: {compiler} did not compile the unit:\n{done.stderr[:2000]}")
        return {f"binaries/{machine}-{system}/{name}.{suffix}": library.read_bytes()}


def _write(target: Path, files: Mapping[str, bytes]) -> None:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in files.items():
                archive.writestr(zipfile.ZipInfo(name, _DATE), content, zipfile.ZIP_DEFLATED)
    except OSError as error:
        raise InputError(f"cannot write {str(target)!r}: {error}.\n  fix: pass a path in a writable folder") from None
