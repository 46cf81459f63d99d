"""Saved files with errors load or end in an error of this package; nothing foreign is imported, little allocated."""

import importlib
import io
import json
import pkgutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hostile_files
import numpy as np
import pytest

import twistax as tx
from twistax.expr import all_nodes


@pytest.fixture
def members(tmp_path: Path) -> dict[str, bytes]:
    x = tx.State("x", shape=(2,))
    table = tx.Interp(x[0], axes=[0.0, 1.0, 3.0], values=[1.0, -1.0, 2.0])
    tx.compile(tx.System(rates={x: tx.Sin(x) * [1.0, 2.0]}, outputs={"y": table})).save(tmp_path / "whole")
    with zipfile.ZipFile(tmp_path / "whole") as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def loaded(folder: Path, members: dict[str, bytes], **more: Any) -> tx.Dynamics:
    (folder / "hostile").write_bytes(hostile_files.written(members, **more))
    return tx.load(folder / "hostile")


def with_node(members: dict[str, bytes], change: Callable[[list[Any]], None]) -> dict[str, bytes]:
    """The members with the first node that has operands changed."""
    content = json.loads(members["system.json"])
    change(next(node for node in content["nodes"] if node[0].endswith(":Sin")))
    return {**members, "system.json": json.dumps(content).encode()}


@pytest.mark.parametrize("number", [3_000_000_000, -1, 2**63, 10**400, 1e308])
@pytest.mark.parametrize("kind", ["number", "shape", "node", "array", "slice"])
def test_a_number_that_cannot_be_is_named(number: Any, kind: str, members: dict[str, bytes], tmp_path: Path) -> None:
    value = {
        "number": {"number": ["<i4", number]},
        "shape": {"value": ["twistax.groups.group:Euclidean", {"shape": {"tuple": [number]}}]},
        "node": {"node": number},
        "array": {"array": number},
        "slice": {"slice": [0, number, 1]},
    }[kind]
    with pytest.raises(tx.TwistaxError):
        loaded(tmp_path, with_node(members, lambda node: node[1].update({next(iter(node[1])): value})))


@pytest.mark.parametrize(
    "module", ["antigravity", "this", "twistax.demo", "twistax.__main__", "twistax.report.command"]
)
def test_no_module_that_a_file_names_is_imported(module: str, members: dict[str, bytes], tmp_path: Path) -> None:
    for name in sorted(name for name in sys.modules if name == module or name.startswith(f"{module}.")):
        pytest.skip(f"{name} is here already")
    with pytest.raises(tx.ModelError, match=f"a x of the module '{module}', which is not known here"):
        loaded(tmp_path, with_node(members, lambda node: node.__setitem__(0, f"{module}:x")))
    assert module not in sys.modules


def test_no_attribute_of_a_module_is_asked_for(
    members: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A module may import more when an attribute is asked for, as scipy and this package do."""
    asked: list[str] = []
    for module in (np, tx):
        monkeypatch.setattr(module, "__getattr__", asked.append)
    for named in ("numpy:something", "twistax:something", "numpy:something.more"):
        with pytest.raises(tx.ModelError, match="which is not known here"):
            loaded(tmp_path, with_node(members, lambda node, named=named: node.__setitem__(0, named)))
    assert asked == []


@pytest.mark.parametrize("named", ["twistax.view.shapes:Box", "twistax.integrators.step_control:StepControl"])
def test_only_values_of_nodes_are_made(named: str, members: dict[str, bytes], tmp_path: Path) -> None:
    importlib.import_module(named.partition(":")[0])
    with pytest.raises(tx.ModelError, match="which is not known here"):
        loaded(tmp_path, with_node(members, lambda node: node[1].update(x={"value": [named, {}]})))


def test_sizes_that_a_file_promises_are_not_allocated(members: dict[str, bytes], tmp_path: Path) -> None:
    with pytest.raises(tx.InputError, match=r"declares 3e\+09 bytes, but a saved system has at most"):
        loaded(tmp_path, members, said=3_000_000_000)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (3_000_000_000,)})
    with pytest.raises(tx.InputError, match=r"an array of shape \(3000000000,\) in .* bytes"):
        loaded(tmp_path, {**members, "arrays/0.npy": header.getvalue() + bytes(16)})


def test_every_class_that_files_may_name_is_known() -> None:
    """A process that has loaded nothing but the reader knows the modules of all nodes."""
    for module in pkgutil.walk_packages(tx.__path__, "twistax."):
        if not module.name.startswith(("twistax.__main__", "twistax.demo", "twistax.report", "twistax.diffrax")):
            importlib.import_module(module.name)
    code = "import sys, twistax.system.export.saved as s; print(*s._ON_DEMAND, *sys.modules)"
    known = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert {cls.__module__ for cls in all_nodes()} <= set(known)


def test_hundreds_of_files_with_errors() -> None:
    """In a process with 1.5 GB of memory more than it has, and 20 s for a file."""
    command = [sys.executable, "-W", "ignore", hostile_files.__file__, "0", "400"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
