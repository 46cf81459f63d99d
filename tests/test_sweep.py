"""Sweeps: every member as by itself, on any number of devices, resumable, failures by number."""

import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx

RANDOM = np.random.default_rng(1)
COUNT = 29
MEMBERS = {"x": RANDOM.normal(size=(COUNT, 3)), "gain": RANDOM.uniform(0.5, 2.0, COUNT)}


def run(member: Any) -> dict[str, jax.Array]:
    return {"sum": jnp.sum(member["x"]) * member["gain"], "all": jnp.sin(member["x"])}


def draw(key: jax.Array) -> dict[str, jax.Array]:
    one, two = jax.random.split(key)
    return {"x": jax.random.normal(one, (3,)), "gain": jax.random.uniform(two)}


EXPECTED = {"sum": MEMBERS["x"].sum(1) * MEMBERS["gain"], "all": np.sin(MEMBERS["x"])}


def test_statistics_are_a_line_for_each_result() -> None:
    words = ["2 members", "a.0: mean 2., std 1.414214, least 1., most 3."]
    words += ["b: mean [4. 5.], std [0. 0.], least [4. 5.], most [4. 5.]"]
    members = {"a": [np.array([1.0, 3.0])], "b": np.array([[4.0, 5.0], [4.0, 5.0]])}
    assert str(tx.sweep(lambda member: member, members).statistics) == "\n".join(words)


@pytest.mark.parametrize("chunk", [1, 4, 29, 100])
def test_values_statistics_and_percentiles(chunk: int) -> None:
    found = tx.sweep(run, MEMBERS, chunk=chunk)
    assert found.count == found.statistics.count == COUNT
    assert found.failed == {}
    for name, values in EXPECTED.items():
        np.testing.assert_allclose(found.values[name], values, rtol=1e-14)
        np.testing.assert_allclose(found.statistics.mean[name], values.mean(0), rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(found.statistics.std[name], values.std(0, ddof=1), rtol=1e-12)
        np.testing.assert_array_equal(found.statistics.least[name], found.values[name].min(0))
        np.testing.assert_array_equal(found.statistics.most[name], found.values[name].max(0))
        np.testing.assert_allclose(found.percentiles([5, 50])[name], np.percentile(values, [5, 50], axis=0), rtol=1e-13)


def test_what_is_drawn_depends_on_the_number_alone() -> None:
    one, other = (tx.sweep(run, draw, count=COUNT, seed=3, chunk=chunk) for chunk in (4, 10))
    np.testing.assert_allclose(one.values["sum"], other.values["sum"], rtol=1e-14)
    own = one.member(17)
    np.testing.assert_allclose(run(own)["sum"], one.values["sum"][17], rtol=1e-14)
    assert len(np.unique(one.values["sum"])) == COUNT
    assert not np.allclose(tx.sweep(run, draw, count=COUNT, seed=4).values["sum"], one.values["sum"])


def test_a_member_that_fails_is_named_and_no_other_is_lost() -> None:
    """x' = x^2 from 1 / 2 ends beyond t = 2 for ever; rates that are not finite, and steps that run out."""
    x, k = tx.State("x"), tx.Parameter("k")
    dynamics = tx.compile(tx.System(rates={x: k * x * x}))

    def rollout(member: Any) -> Any:
        control = tx.StepControl(max_steps=200)
        solution = tx.integrate(
            dynamics, {"x": 0.5}, t1=3.0, rtol=1e-6, params={"k": member}, control=control, throw=False
        )
        return solution, {"end": solution.xs["x"][-1]}

    rates = np.array([0.1, 1.0, 0.2, np.nan, 0.3])
    found = tx.sweep(rollout, rates, chunk=2)
    assert list(found.failed) == [1, 3]
    assert all(isinstance(result, tx.Result) for result in found.failed.values())
    good = np.array([0.1, 0.2, 0.3])
    exact = 0.5 / (1 - 0.5 * good * 3.0)
    np.testing.assert_allclose(found.values["end"][[0, 2, 4]], exact, rtol=1e-5)
    np.testing.assert_allclose(found.statistics.mean["end"], exact.mean(), rtol=1e-5)
    assert "2 failed" in repr(found)


def test_solutions_and_plain_arrays() -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: -x}))
    found = tx.sweep(lambda x0: tx.integrate(dynamics, {"x": x0}, t1=1.0, dt=0.1), np.array([1.0, 2.0]))
    np.testing.assert_allclose(found.values["x"], np.exp(-1.0) * np.array([[1.0], [2.0]]), rtol=1e-6)
    plain = tx.sweep(lambda x: jnp.sqrt(x), np.array([4.0, -1.0]))
    assert plain.failed == {1: tx.Result.NON_FINITE}
    assert plain.values[0] == 2.0
    none = tx.sweep(lambda x: jnp.sqrt(x), np.array([-4.0, -1.0]))
    assert np.isnan(none.statistics.mean)
    assert none.statistics.count == 0


def test_integers_and_truth_values() -> None:
    members = {"a": np.array([127, -128], np.int8), "b": np.array([2**31 - 1, -(2**31)], np.int32)}
    found = tx.sweep(lambda m: {**m, "c": m["a"] > 0}, members)
    assert found.percentiles(50) == {"a": -0.5, "b": -0.5, "c": 0.5}
    assert found.statistics.mean == {"a": -0.5, "b": -0.5, "c": 0.5}
    assert np.isnan(tx.sweep(lambda x: x, np.ones(1)).statistics.std)


def test_numbers_that_numpy_has_not(tmp_path: Path) -> None:
    """Single precision holds them."""
    members = np.arange(8.0)
    for directory in (None, tmp_path):
        found = tx.sweep(lambda m: (m.astype(jnp.bfloat16), m > 2), members, chunk=3, directory=directory)
        assert found.values[0].dtype == np.float32
        np.testing.assert_array_equal(found.values[0], members)
    huge = tx.sweep(lambda m: m, np.array([1e200, -1e200])).statistics
    assert (huge.mean, huge.std) == (0.0, np.inf)


def test_a_failure_within_the_results_is_seen() -> None:
    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: x * x}))

    def end(x0: jax.Array) -> Any:
        return tx.integrate(dynamics, {"x": x0}, t1=2.0, rtol=1e-6, throw=False)

    starts = np.array([0.1, 2.0])
    assert list(tx.sweep(lambda x0: end(x0).xs["x"][-1], starts).failed) == [1]
    with pytest.raises(tx.InputError, match="a Solution within its results"):
        tx.sweep(lambda x0: {"end": end(x0)}, starts)


# ---- on disk ---------------------------------------------------------------------------------------------------------


def test_what_is_not_finite_hides_no_other_function(tmp_path: Path) -> None:
    members = np.array([1.0, 2.0, 3.0])
    tx.sweep(lambda m: jnp.stack([jnp.where(m > 2.5, jnp.inf, 1e7 * m), m]), members, directory=tmp_path)
    tx.sweep(lambda m: jnp.stack([jnp.where(m > 2.5, jnp.inf, 1e7 * m), m]), members, directory=tmp_path)
    with pytest.raises(tx.InputError, match="another function"):
        tx.sweep(lambda m: jnp.stack([jnp.where(m > 2.5, jnp.inf, 1e7 * m), -m]), members, directory=tmp_path)


def test_a_directory_of_another_sweep_is_refused(tmp_path: Path) -> None:
    tx.sweep(run, MEMBERS, chunk=8, directory=tmp_path)
    with pytest.raises(tx.InputError, match="contains another sweep: chunk 8 there, 4 here"):
        tx.sweep(run, MEMBERS, chunk=4, directory=tmp_path)
    with pytest.raises(tx.InputError, match="contains another sweep: members"):
        tx.sweep(run, {**MEMBERS, "gain": MEMBERS["gain"] + 1}, chunk=8, directory=tmp_path)
    with pytest.raises(tx.InputError, match="another function: chunk 0"):
        tx.sweep(lambda m: {**run(m), "sum": m["gain"]}, MEMBERS, chunk=8, directory=tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(tx.InputError, match="cannot use the directory"):
        tx.sweep(run, MEMBERS, chunk=8, directory=tmp_path / "file")


# ---- many devices ----------------------------------------------------------------------------------------------------

_START = """
import sys
import jax, numpy as np
jax.config.update("jax_enable_x64", True)
import twistax as tx
"""

_SYSTEM = """
w, k = tx.State("w", shape=(3,)), tx.Parameter("k")
J = np.diag([1.0, 2.0, 3.0])
rate = tx.linalg.Solve(J, -k * w - tx.linalg.Cross(w, J @ w))
def members(key):
    return jax.random.normal(key, (3,))
def ends(backend, devices=None, directory=None):
    dynamics = tx.compile(tx.System(rates={w: rate}), backend=backend)
    def run(x):
        return tx.integrate(dynamics, {"w": x}, t1=0.5, steps=50, params={"k": 0.1})
    return tx.sweep(run, members, count=37, chunk=16, devices=devices, directory=directory).values["w"]
"""

_EIGHT = """
assert jax.local_device_count() == 8
for backend in (tx.JAX(), tx.XLA(least=0), tx.Native(least=0), "auto"):
    one, all = ends(backend, jax.local_devices()[:1]), ends(backend)
    assert one.shape == all.shape == (37, 1, 3)
    np.testing.assert_allclose(one, all, rtol=1e-13)
"""

_TWO = """
port, process, directory = sys.argv[1:]
jax.distributed.initialize(f"localhost:{port}", num_processes=2, process_id=int(process))
assert jax.process_count() == 2
found = ends("auto", directory=directory)
np.save(f"{directory}/found{process}.npy", found)
"""


def _python(code: str, *arguments: str, flags: str = "") -> subprocess.Popen[str]:
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {flags}"}
    command = [sys.executable, "-W", "error", "-c", _START + code, *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)


def test_eight_devices() -> None:
    process = _python(_SYSTEM + _EIGHT, flags="--xla_force_host_platform_device_count=8")
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 0, said


def test_two_processes(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    both = [_python(_SYSTEM + _TWO, str(port), str(k), str(tmp_path)) for k in range(2)]
    for process in both:
        said, _ = process.communicate(timeout=120)
        assert process.returncode == 0, said
    one, other = (np.load(tmp_path / f"found{k}.npy") for k in range(2))
    np.testing.assert_array_equal(one, other)
    assert one.shape == (37, 1, 3)
    assert sorted(path.name for path in tmp_path.glob("*.npz")) == ["000000.npz", "000001.npz", "000002.npz"]


# ---- nonsense --------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("message", "own"),
    [
        ("a count if members is a function", {"members": draw}),
        ("arrays of 29 members, but count is 3", {"count": 3}),
        ("one length of the leading axis", {"members": {"a": np.zeros(2), "b": np.zeros(3)}}),
        ("sweep: chunk must be a whole number of 1 or more, got 0", {"chunk": 0}),
        ("sweep: count must be a whole number of 1 or more, got 2.5", {"members": draw, "count": 2.5}),
        (r"sweep expects a function of \(member\), got 3", {"run": 3}),
        (r"members expects a function of \(key\), got one with the arguments", {"members": lambda: 1, "count": 2}),
        ("returns nothing", {"run": lambda member: None}),
        ("the same member for every key", {"members": lambda key: {"x": np.ones(3), "gain": 1.0}, "count": 3}),
        ("real numbers, got complex128", {"run": lambda member: jax.lax.complex(member["x"], member["x"])}),
        ("seed must be less than 2", {"members": draw, "count": 2, "seed": 2**32}),
        ("seed must be a whole number", {"members": draw, "count": 2, "seed": 1.5}),
        ("at least 1, got shapes", {"members": np.zeros((0, 3))}),
        ("at least 1, got shapes", {"members": [1.0, 2.0]}),
        ("devices must be a list", {"devices": []}),
        ("devices must be a list", {"devices": "cpu"}),
        ("list of different devices", {"devices": [*jax.devices(), *jax.devices()]}),
        ("sweep", {"directory": 3}),
        ("arrays of known numbers, got PRNGKeyArray", {"members": jax.random.split(jax.random.key(0), 3)}),
        ("arrays of known numbers, got ndarray", {"members": np.array(["a", "b"])}),
        ("real numbers, got key", {"run": lambda member: jax.random.key(0)}),
        ("progress expects True, False or None", {"progress": "yes"}),
    ],
)
def test_nonsense_is_refused(message: str, own: dict[str, Any]) -> None:
    with pytest.raises(tx.InputError, match=message):
        tx.sweep(**{"run": run, "members": MEMBERS, **own})


@pytest.mark.usefixtures("unchecked")
def test_reading_nonsense_is_refused() -> None:
    found = tx.sweep(run, MEMBERS)
    with pytest.raises(tx.InputError, match="from 0 to 28, got 29"):
        found.member(29)
    with pytest.raises(tx.InputError, match="from 0 to 100, got 101"):
        found.percentiles(101)
    with pytest.raises(tx.InputError, match="percentiles expects real numbers, got 'a'"):
        found.percentiles("a")
    with pytest.raises(tx.InputError, match="call sweep outside of jit"):
        jax.jit(lambda members: tx.sweep(run, members).values)(MEMBERS)
