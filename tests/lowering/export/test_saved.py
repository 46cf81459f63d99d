"""Compiled systems in files and out of them."""

from __future__ import annotations

import io
import json
import os
import pickle
import zipfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

import twistax as tx
import twistax.mechanics
from twistax.expr import Example, Expr


def again(dynamics: tx.Dynamics, folder: Path) -> tx.Dynamics:
    dynamics.save(folder / "system.twistax")
    return tx.load(folder / "system.twistax")


def full() -> tx.System:
    """A system in which everything has a value that is not the usual one."""
    g = tx.State("g", group=tx.SE3, order=tx.ANGULAR_FIRST, initial=np.eye(4), scale=2.0)
    w = tx.State("w", shape=(6,), min=-3.0, max=[1.0, 2.0, 3.0, 4.0, 5.0, np.inf], guess=np.linspace(0.0, 1.0, 6))
    u, unused = tx.Control("u", shape=(3,), min=-1.0, guess=[0.1, 0.2, 0.3]), tx.Control("unused")
    k, J = tx.Parameter("k", value=1.0 / 3.0), tx.Parameter("J", shape=(3, 3))
    rate = tx.Concat(J @ w[:3] * k - tx.linalg.Cross(u, w[3:]), tx.Where(tx.Time() >= 1.0, w[:3], -w[3:]))
    table = tx.Cinterp(w[0], [0.0, 1.0, 3.0, 4.0], [1.0, -1.0, 2.0, 2.5], method="akima")
    return tx.System(
        rates={w: rate, g: w},
        outputs={"table": table, "height": g[2, 3], "all": tx.Vmap(lambda p: p @ w[:3], batch=np.eye(3) * k)},
        constraints={"box": u <= 3.0, "level": g[2, 3] == 1.0, "kept": w >= -1e300},
        controls=[unused, u],
        parameters=[J, k],
    )


def test_a_system_comes_back(tmp_path: Path) -> None:
    dynamics = tx.compile(full(), outputs=["height", "table"], bake={"J": np.diag([0.1, 0.2, 0.7])}, backend=tx.JAX())
    loaded = again(dynamics, tmp_path)
    old, new = dynamics.system, loaded.system
    for kind in ("rates", "outputs", "constraints"):
        pairs = zip(getattr(old, kind).items(), getattr(new, kind).items(), strict=True)
        assert all(a == b and one.key() == other.key() for (a, one), (b, other) in pairs), kind
    for kind in ("states", "controls", "parameters"):
        for one, other in zip(getattr(old, kind), getattr(new, kind), strict=True):
            assert type(one) is type(other)
            fields = {name: value for name, value in one.__dict__.items() if name != "_sealed"}
            for name, value in fields.items():
                np.testing.assert_array_equal(getattr(other, name, None), value, err_msg=f"{one.name}.{name}")
    assert new.states[1].order is tx.ANGULAR_FIRST
    assert list(loaded.baked) == ["J"]
    assert [p.name for p in loaded.parameters] == ["k"]
    assert list(loaded.functions.families["outputs"]) == ["height", "table"]
    assert loaded.backend == tx.JAX()
    assert loaded.group == dynamics.group

    rng = np.random.default_rng(0)
    x = {"g": np.asarray(tx.lie.se3.exp(rng.normal(size=6))), "w": rng.normal(size=6)}
    u = {"u": rng.normal(size=3)}
    for family in ("__call__", "outputs", "constraints"):
        one, other = (getattr(d, family)(0.3, x, u) for d in (dynamics, loaded))
        jax.tree.map(np.testing.assert_array_equal, one, other)


def test_kinds_and_units_come_back(tmp_path: Path) -> None:
    g = tx.State("g", group=tx.SE3, kind=tx.kinds.Pose("world", "body"))
    V = tx.State("V", (6,), kind=tx.Twist("body", of="craft", relative_to="world"))
    F, k = tx.Control("F", (3,), kind=tx.FreeVector("world"), unit="N"), tx.Parameter("k", value=2.0, unit="1/s")
    h = tx.kinds.declare(g[2, 3] * 2, unit=tx.kinds.Unit.of("m") ** 1)
    root = tx.Parameter("root", value=1.0, unit=tx.kinds.Unit.of("m") ** Fraction(1, 2))
    system = tx.System(rates={g: V, V: -k * V}, outputs={"h": h, "F": g[:3, :3].T @ F, "root": root})
    dynamics = tx.compile(system)
    loaded = again(dynamics, tmp_path)
    assert str(loaded.explain(kinds=True)) == str(dynamics.explain(kinds=True))
    assert loaded.system.states[1].kind == V.kind
    push = tx.Parameter("push", value=1.0, unit="kg")
    with pytest.raises(tx.KindError, match="kg"):
        tx.join(loaded.system, connect={"k": push}, outputs={"sum": loaded.system.output("h") + push})


def test_values_that_change_after_compiling_are_not_saved(tmp_path: Path) -> None:
    J = np.eye(3)
    dynamics = tx.compile(full(), bake={"J": J})
    J[0, 0] = 5.0
    assert again(dynamics, tmp_path).baked["J"][0, 0] == 1.0


def test_the_backend_comes_back_or_is_chosen(tmp_path: Path) -> None:
    chosen = tx.Native(scalars=tx.XLA(checked=True, least=7), threads=3)
    dynamics = tx.compile(full(), backend=chosen)
    assert again(dynamics, tmp_path).backend == chosen
    assert tx.load(tmp_path / "system.twistax", backend=tx.JAX()).backend == tx.JAX()
    default = tx.compile(full())
    assert tx.load(tmp_path / "system.twistax", backend="auto").backend == default.backend
    assert again(default, tmp_path).backend == default.backend


def test_equal_systems_give_equal_files_without_pickles(tmp_path: Path) -> None:
    tx.compile(full()).save(tmp_path / "a")
    tx.compile(full()).save(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    with zipfile.ZipFile(tmp_path / "a") as archive:
        kinds = {Path(name).suffix for name in archive.namelist()}
    assert kinds == {".json", ".npy"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


# ---- files that are not as they should be ----------------------------------------------------------------------------


def edited(path: Path, change: Any) -> Path:
    """The file with its JSON changed."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    content = json.loads(members["system.json"])
    change(content)
    members["system.json"] = json.dumps(content).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


@pytest.fixture
def file(tmp_path: Path) -> Path:
    x = tx.State("x", shape=(2,))
    tx.compile(tx.System(rates={x: tx.Sin(x) * [1.0, 2.0]})).save(tmp_path / "s")
    return tmp_path / "s"


def test_another_format_is_refused(file: Path) -> None:
    edited(file, lambda content: content.update(format=4, twistax="9.9.9"))
    with pytest.raises(tx.InputError, match=r"saved by twistax 9\.9\.9 in format 4; but twistax .* format 3"):
        tx.load(file)


def test_damaged_files_are_refused(file: Path, tmp_path: Path) -> None:
    whole = file.read_bytes()
    for part in (b"", whole[: len(whole) // 2], whole[:-5], b"no archive at all", whole[:60] + b"\xff" + whole[61:]):
        file.write_bytes(part)
        with pytest.raises(tx.InputError, match=r"'.*s' is "):
            tx.load(file)
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("system.json", b'{"format": 3, "twistax": "0"}')
    with pytest.raises(tx.InputError, match="not a saved system, or is damaged"):
        tx.load(file)
    with pytest.raises(tx.InputError, match="there is no file"):
        tx.load(tmp_path / "nowhere")
    for place in (tmp_path / "no" / "folder", tmp_path, ""):
        with pytest.raises(tx.InputError, match="cannot save to"):
            tx.compile(full()).save(place)


def with_array(path: Path, data: bytes) -> None:
    """The file with the bytes of its first array changed."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["arrays/0.npy"] = data
    with zipfile.ZipFile(path, "w") as archive:
        for name, own in members.items():
            archive.writestr(name, own)


class Runs:
    """Makes a folder when it is read by pickle."""

    def __init__(self, made: Path) -> None:
        self.made = made

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.made),)


def test_arrays_that_are_none_are_refused_and_nothing_runs(file: Path, tmp_path: Path) -> None:
    made = tmp_path / "made"
    objects, several, huge = io.BytesIO(), io.BytesIO(), io.BytesIO()
    np.save(objects, np.array([Runs(made)], object), allow_pickle=True)
    np.savez(several, a=np.ones(2))
    np.lib.format.write_array_header_1_0(huge, {"descr": "<f8", "fortran_order": False, "shape": (10**15,)})
    for data in (objects.getvalue(), pickle.dumps(Runs(made)), several.getvalue(), huge.getvalue(), b""):
        with_array(file, data)
        with pytest.raises(tx.InputError, match=r"damaged|not a complete file"):
            tx.load(file)
    assert not made.exists()


def test_a_changed_tree_is_refused(file: Path) -> None:
    def swap(content: Any) -> None:
        for node in content["nodes"]:
            node[0] = node[0].replace(":Sin", ":Cos")

    edited(file, swap)
    with pytest.raises(tx.ModelError, match="differ from the saved ones"):
        tx.load(file)


def test_a_changed_output_is_refused(tmp_path: Path) -> None:
    x = tx.State("x")
    path = tmp_path / "system"
    tx.compile(tx.System(rates={x: -x}, outputs={"y": tx.Sin(x)}, constraints=[tx.Sin(2.0 * x) <= 0.5])).save(path)
    for k in range(2):
        found = 0

        def swap(content: Any, k: int = k) -> None:
            nonlocal found
            for node in content["nodes"]:
                if node[0].endswith(":Sin"):
                    node[0] = node[0].replace(":Sin", ":Cos") if found == k else node[0]
                    found += 1

        copy = tmp_path / f"copy{k}"
        copy.write_bytes(path.read_bytes())
        edited(copy, swap)
        assert found == 2
        with pytest.raises(tx.ModelError, match="differ from the saved ones"):
            tx.load(copy)


@pytest.mark.parametrize(
    "named", ["twistax.expr.operations.arithmetic:Nothing", "twistax.nowhere:Sin", "os:system", "subprocess:Popen"]
)
def test_unknown_classes_are_named_and_nothing_runs(file: Path, named: str) -> None:
    edited(file, lambda content: content["nodes"][1].__setitem__(0, named))
    with pytest.raises(tx.ModelError, match=f"a {named.partition(':')[2]} of the module '{named.partition(':')[0]}'"):
        tx.load(file)


def test_fields_that_changed_are_told(file: Path) -> None:
    edited(file, lambda content: content["nodes"][1][1].update(more=1.0))
    with pytest.raises(tx.ModelError, match="has the fields"):
        tx.load(file)


# ---- classes of a user's ---------------------------------------------------------------------------------------------


class Doubled(Expr):
    """2 x of one's own."""

    x: tx.expr.fields.Operand
    by: Any = 2.0

    def infer_shape(self, *shapes: Any) -> Any:
        return shapes[0]

    def evaluate(self, *values: jax.Array) -> jax.Array:
        return self.by * values[0]

    @classmethod
    def example(cls) -> list[Example]:
        return []


def test_code_is_not_saved(tmp_path: Path) -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: Doubled(x, by=np.sin)}))
    with pytest.raises(tx.ModelError, match=r"Doubled\.by is .* cannot be saved"):
        dynamics.save(tmp_path / "s")
    assert not list(tmp_path.iterdir())
