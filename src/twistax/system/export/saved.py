"""Saving and loading of compiled systems.

A file is a zip archive: `system.json` contains the expressions as a list of nodes, operands first, the declarations and
the compile options; `arrays/0.npy`, ... contain the arrays. It contains the expressions, not the code made from them:
it is small, states the meaning of the system, and contains nothing executable; code is compiled again on the machine
that loads it.
"""

from __future__ import annotations

import dataclasses
import importlib
import io
import itertools
import json
import math
import os
import sys
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import path_of
from ...errors import InputError, ModelError, TwistaxError
from ...expr import Constant, Expr, Leaf
from ...expr.graph import FACTS
from ...expr.moved import first_module, module_now
from ...expr.node import node_classes
from ...groups import ANGULAR_FIRST, LINEAR_FIRST, SE3, SO3, Group
from ...scalar.backends import Backend
from ...scalar.kernel_cache import version
from ...scalar.walk import walk
from ..functions import Functions
from ..system import System

#: Raised whenever a file of the old form would be read wrongly.
_FORMAT = 3
#: The member of the archive that says everything but the arrays.
_JSON = "system.json"
_FIXED_TIME = (1980, 1, 1, 0, 0, 0)  # equal systems give equal files
_PACKAGE = __name__.partition(".")[0]
#: Modules with classes that files may name and that `import twistax` does not load. No other module is ever imported.
_ON_DEMAND = tuple(
    f"{_PACKAGE}.{name}"
    for name in (
        "mechanics.environment.atmosphere",
        "mechanics.environment.earth",
        "mechanics.environment.harmonics",
        "trajectory.problem.functionals",
    )
)
#: Where the values of fields are defined that are no groups and no backends.
_OF_FIELDS = ("expr.kinds.kinds", "expr.kinds.unit", "expr.tables.kinds", "groups.special")
_VALUES = (*(f"{_PACKAGE}.{name}" for name in _OF_FIELDS), *_ON_DEMAND)
#: Bytes that the members of an archive may have in all. A file of a few kB could say that it has any number.
_LARGEST = 2**30
#: Values of which there is one object.
_KNOWN: tuple[Any, ...] = (LINEAR_FIRST, ANGULAR_FIRST, SO3, SE3)
_FAMILIES, _LEAVES = ("rates", "outputs", "constraints", "corrections"), ("states", "controls", "parameters")
_SHAPE, _ORIGIN = "_shape", "_folded_from"
#: What the check of kinds reads of a leaf, and the names of all that only some nodes have.
_KINDS = ("kind", "unit", "_whole")
_OPTIONAL = (_SHAPE, _ORIGIN, *_KINDS, *FACTS)


# ---- files -----------------------------------------------------------------------------------------------------------


def save(dynamics: Functions, path: str | Path) -> None:
    """Implements `Dynamics.save`.

    Raises:
        ModelError: a field that cannot be written as plain data.
        InputError: the file cannot be written.
    """
    arrays: list[NDArray[Any]] = []
    members = {_JSON: json.dumps(_content(dynamics, arrays), allow_nan=False).encode()}
    for k, array in enumerate(arrays):
        data = io.BytesIO()
        np.save(data, array, allow_pickle=False)
        members[f"arrays/{k}.npy"] = data.getvalue()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, member in members.items():
            archive.writestr(zipfile.ZipInfo(name, _FIXED_TIME), member, zipfile.ZIP_DEFLATED)
    target = path_of("save: path", path)
    partial = target.parent / f"{target.name}.{os.getpid()}.part"
    try:
        # Written beside, then moved: a file is whole or not there.
        partial.write_bytes(buffer.getvalue())
        partial.replace(target)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise InputError(
            f"cannot save to {str(target)!r}: {error}.\n  fix: pass a path in an existing folder"
        ) from None


def read(path: str | Path) -> tuple[System, dict[str, Any]]:
    """The system in a file, and the options of `tx.compile`. Raises the errors of `tx.load`."""
    path = path_of("load: path", path)
    place = repr(str(path))
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
            if size > _LARGEST:
                raise InputError(
                    f"{place} declares {size:.3g} bytes, but a saved system has at most {_LARGEST:.3g}.\n"
                    "  fix: use a file that Dynamics.save wrote, and pass larger tables as parameters"
                )
            content = json.loads(archive.read(_JSON))
            if content["format"] != _FORMAT:
                raise InputError(
                    f"{place} was saved by twistax {content['twistax']} in format {content['format']}; but "
                    f"twistax {version()} reads format {_FORMAT}.\n"
                    f"  fix: load it with twistax {content['twistax']}, or "
                    "save the system again with this one"
                )
            arrays = [_array(archive.read(f"arrays/{k}.npy")) for k in range(content["arrays"])]
        system, options = _system(content, arrays)
        if _keys(system) != content["keys"]:
            raise ModelError(
                f"the expressions of {place} differ from the saved ones: one of their classes has changed since "
                f"twistax "
                f"{content['twistax']} saved them.\n  fix: load the file with that version"
            )
    except FileNotFoundError:
        raise InputError(f"there is no file {place}; load expects a file that Dynamics.save wrote") from None
    except OSError as error:
        raise InputError(f"cannot load {place}: {error}.\n  fix: use a file that Dynamics.save wrote") from None
    except TwistaxError:
        raise
    except MemoryError:
        raise InputError(f"{place} is damaged, or too large for the available memory") from None
    except (zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, EOFError) as error:
        raise InputError(
            f"{place} is not a complete file of a saved system: {error}.\n  fix: use a file that Dynamics.save wrote"
        ) from None
    except Exception as error:  # constructors of all classes run on what a damaged file says
        raise InputError(f"{place} is not a saved system, or is damaged: {type(error).__name__}: {error}") from error
    return system, options


def _array(data: bytes) -> NDArray[Any]:
    """The array of a .npy file, read-only as in leaves. Nothing is allocated before its header is checked against the
    data.

    Raises: ValueError for another version, kind of numbers or length.
    """
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in header:
        raise ValueError(f"an array of version {version}")
    shape, by_columns, dtype = header[version](file)
    if dtype.kind not in "biuf":
        raise ValueError(f"an array of {dtype}")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(data) - file.tell():
        raise ValueError(f"an array of shape {shape} in {len(data)} bytes")
    return np.frombuffer(data, dtype, offset=file.tell()).reshape(shape, order="F" if by_columns else "C")


def _content(dynamics: Functions, arrays: list[NDArray[Any]]) -> dict[str, Any]:
    system = dynamics.system
    leaves: dict[str, Sequence[Leaf]] = {kind: getattr(system, kind) for kind in _LEAVES}
    named: dict[str, dict[str, Expr]] = {kind: getattr(system, kind) for kind in _FAMILIES}
    known = [expr for pairs in system.slopes.values() for pair in pairs for expr in pair]
    roots = [*itertools.chain(*leaves.values()), *(e for members in named.values() for e in members.values()), *known]
    nodes, places = write_nodes(roots, arrays)
    compiled = {
        "outputs": list(dynamics.families["outputs"]),
        "bake": [[n, _written(v, f"bake[{n!r}]", arrays, places)] for n, v in dynamics.baked.items()],
        "backend": _written(dynamics.backend, "the backend", arrays, places),
    }
    return {
        "format": _FORMAT,
        "twistax": version(),
        "nodes": nodes,
        **{kind: [places[id(leaf)] for leaf in members] for kind, members in leaves.items()},
        **{kind: [[name, places[id(e)]] for name, e in members.items()] for kind, members in named.items()},
        "slopes": [[name, [[places[id(e)] for e in pair] for pair in pairs]] for name, pairs in system.slopes.items()],
        "labels": system.labels,
        "compiled": compiled,
        "keys": _keys(system),
        "arrays": len(arrays),
    }


def _system(content: dict[str, Any], arrays: list[NDArray[Any]]) -> tuple[System, dict[str, Any]]:
    nodes: list[Any] = read_nodes(content["nodes"], arrays)
    states = {nodes[place].name: nodes[place] for place in content["states"]}
    families = ({n: nodes[place] for n, place in content.get(kind, [])} for kind in _FAMILIES)
    rates, outputs, constraints, corrections = families
    system = System(
        rates={states[name]: rate for name, rate in rates.items()},
        outputs=outputs,
        constraints=constraints,
        corrections=corrections,
        controls=[nodes[place] for place in content["controls"]],
        parameters=[nodes[place] for place in content["parameters"]],
        slopes={name: [(nodes[by], nodes[slope]) for by, slope in pairs] for name, pairs in content.get("slopes", [])},
        labels=content.get("labels"),
    )
    compiled = content["compiled"]
    bake = {name: _value(value, arrays, nodes) for name, value in compiled["bake"]}
    backend = _value(compiled["backend"], arrays, nodes)
    return system, {"outputs": compiled["outputs"], "bake": bake, "backend": backend}


def _keys(system: System) -> list[str]:
    """The structure of everything that is computed, in order."""
    known = [expr for pairs in system.slopes.values() for pair in pairs for expr in pair]
    named = [e for kind in _FAMILIES for e in getattr(system, kind).values()]
    return [e.key() for e in (*named, *known)]


# ---- nodes -----------------------------------------------------------------------------------------------------------


def write_nodes(roots: Iterable[Expr], arrays: list[NDArray[Any]]) -> tuple[list[Any], dict[int, int]]:
    """The nodes below the roots as JSON, shared ones once, and the index of each by its id.

    Raises:
        ModelError: a field that cannot be written as plain data.
    """
    places: dict[int, int] = {}
    written: list[Any] = []
    for node in walk(roots, lambda node: list(_expressions(list(_fields(node).values())))):
        name = type(node).__name__
        plain = {key: _written(value, f"{name}.{key}", arrays, places) for key, value in _fields(node).items()}
        places[id(node)] = len(written)
        written.append([_reference(type(node)), plain])
    return written, places


def read_nodes(written: Sequence[Any], arrays: list[NDArray[Any]]) -> list[Expr]:
    """The inverse of `write_nodes`.

    Raises:
        ModelError: an unknown class, or one whose fields have changed.
    """
    nodes: list[Expr] = []
    for named, fields in written:
        cls = _class_of(named)
        if cls is None or not issubclass(cls, Expr):
            raise _unknown_class(named)
        values = {name: _value(value, arrays, nodes) for name, value in fields.items()}
        declared = {field.name for field in cls._fields}
        if declared != {name for name in values if name in declared or name not in _OPTIONAL}:
            raise ModelError(
                f"{cls.__name__} has the fields {sorted(declared)}, but in the file {sorted(values)}.\n"
                "  fix: load it with the version that saved it"
            )
        nodes.append(cls.from_fields(values, validated=False))
    return nodes


def _fields(node: Expr) -> dict[str, Any]:
    """The named fields from which a node is made."""
    fields = {field.name: getattr(node, field.name) for field in type(node)._fields}
    if isinstance(node, Leaf):
        fields[_SHAPE] = node.shape
    facts = (*FACTS, *_KINDS) if isinstance(node, Leaf) else FACTS
    fields |= {name: node.__dict__[name] for name in facts if name in node.__dict__}
    if isinstance(node, Constant) and node.folded_from is not None:
        fields[_ORIGIN] = node.folded_from
    return fields


def _expressions(value: Any) -> Iterator[Expr]:
    if isinstance(value, Expr):
        yield value
    elif isinstance(value, (tuple, list)):
        for entry in value:
            yield from _expressions(entry)


# ---- values without code in them: what a file may hold ---------------------------------------------------------------


def _written(value: Any, where: str, arrays: list[NDArray[Any]], places: dict[int, int]) -> Any:
    """A value as JSON: numbers, text, arrays, slices, tuples, lists, expressions, frozen dataclasses of this package.

    Raises:
        ModelError: there is no plain form; names where it stands.
    """

    def several(values: Iterable[Any]) -> list[Any]:
        return [_written(v, where, arrays, places) for v in values]

    if value is None or isinstance(value, (bool, str)) or type(value) is int:
        return value
    if isinstance(value, Fraction):
        return {"fraction": str(value)}
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else {"float": repr(float(value))}
    if value is Ellipsis:
        return {"ellipsis": None}
    if isinstance(value, Expr):
        return {"node": places[id(value)]}
    if isinstance(value, slice):
        return {"slice": several((value.start, value.stop, value.step))}
    if isinstance(value, (tuple, list)):
        return {type(value).__name__: several(value)}
    if isinstance(value, np.generic) and value.dtype.kind in "biu":
        return {"number": [value.dtype.str, int(value)]}
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if dataclasses.is_dataclass(value) and not isinstance(value, type) and _constructible(type(value)):
        names = [field.name for field in dataclasses.fields(value)]
        fields = dict(zip(names, several(getattr(value, name) for name in names), strict=True))
        return {"value": [_reference(type(value)), fields]}
    raise ModelError(
        f"{where} is {value!r}, which cannot be saved: files contain numbers, text, arrays and values of "
        "twistax, but no code.\n  fix: make a group or a value a frozen dataclass of these"
    )


def _value(written: Any, arrays: Sequence[NDArray[Any]], nodes: Sequence[Expr]) -> Any:
    """The inverse of `_written`.

    Raises:
        ModelError: a class that is not known here.
    """
    if not isinstance(written, dict):
        return written
    ((kind, content),) = written.items()
    match kind:
        case "float":
            return float(content)
        case "fraction":
            return Fraction(content)
        case "ellipsis":
            return Ellipsis
        case "node" | "array":
            if content < 0:
                raise IndexError(f"{kind} {content}")
            return (nodes if kind == "node" else arrays)[content]
        case "number":
            return np.dtype(content[0]).type(content[1])
        case "slice" | "tuple" | "list":
            parts = [_value(v, arrays, nodes) for v in content]
            return slice(*parts) if kind == "slice" else tuple(parts) if kind == "tuple" else parts
        case "value":
            named, fields = content
            cls = _class_of(named)
            if cls is None or not _constructible(cls):
                raise _unknown_class(named)
            value_of_class = cls(**{name: _value(value, arrays, nodes) for name, value in fields.items()})
            return next((known for known in _KNOWN if known == value_of_class), value_of_class)
    raise KeyError(kind)


def _reference(cls: type) -> str:
    return f"{first_module(cls)}:{cls.__qualname__}"


def _class_of(named: str) -> type | None:
    """The class of that name: a class of this package, or a node, group or backend of whoever runs.

    No attribute of a module is asked for, which may import more, and no module is imported that is not known here.
    """
    module, _, name = named.partition(":")
    module = module_now(module)
    if module in _ON_DEMAND:
        importlib.import_module(module)
    value = vars(sys.modules[module]).get(name) if module in _VALUES and module in sys.modules else None
    if isinstance(value, type) and _reference(value) == named:
        return value
    return next((cls for cls in (*node_classes(), *_below(Group), *_below(Backend)) if _reference(cls) == named), None)


def _below(base: type) -> Iterator[type]:
    """All classes below one, wherever they are defined."""
    classes: list[type] = base.__subclasses__()
    for cls in classes:
        yield cls
        yield from _below(cls)


def _constructible(cls: type) -> bool:
    """Whether a file may make values of a class: frozen dataclasses that fields of nodes hold, groups and backends."""
    frozen = dataclasses.is_dataclass(cls) and cls.__dataclass_params__.frozen  # type: ignore[attr-defined]
    return frozen and (cls.__module__ in _VALUES or issubclass(cls, (Group, Backend)))


def _unknown_class(named: str) -> ModelError:
    module, _, name = named.partition(":")
    return ModelError(
        f"the file has a {name} of the module {module!r}, which is not known here.\n"
        f"  fix: import what defines it before tx.load, in a version that has it"
    )
