"""`python -m twistax report`, run."""

import csv
import dataclasses
import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.__main__ import main
from twistax.report.harness.store import Origin, Store
from twistax.report.harness.timing import Repeats
from twistax.report.work_precision import integrators, page
from twistax.report.work_precision.integrators import (
    INTEGRATORS,
    QUICK,
    Counts,
    Integrator,
    SceneProgram,
    measure_scene,
    tolerances,
)
from twistax.scenes import SCENES, Scene

TOP = SCENES["euler-top"]
ORIGIN = Origin({"jax": "1"}, "abc", "a machine", {})
SHORT = dataclasses.replace(QUICK, tolerances=tolerances(-6, -9, 1), repeats=Repeats(4, 2, 0.05))


def pretended(scene: Scene) -> SceneProgram:
    """Knows the answer, and misses it by the tolerance."""

    def solve(start: Any, tolerance: jax.Array) -> tuple[Any, Counts]:
        good = tolerance > 3e-9
        return start["w"] + tolerance, Counts(jnp.asarray(3), jnp.asarray(1), jnp.asarray(24), good)

    return SceneProgram({"w": jnp.asarray(scene.end["w"])}, solve, lambda w: {**scene.end, "w": w})


def test_a_run_leaves_tables_figures_and_a_page_and_goes_on_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["report", "--quick", "--scene", "euler-top", "--out", str(tmp_path)]
    words += ["--method", "dop853-quaternion", "--method", "diffrax-tsit5-call"]
    assert main(words) == 0
    said = capsys.readouterr()
    assert said.err == ""  # no bar where there is no terminal
    assert "  18 rows" in said.out
    assert "  Euler top, error 1e-6, DOP853, quaternion over diffrax in one call" in said.out

    with (tmp_path / "report.csv").open() as file:
        table = list(csv.DictReader(file))
    assert len(table) == 18
    for method in ("dop853-quaternion", "diffrax-tsit5-call"):
        errors = [float(row["error"]) for row in table if row["by"] == method]
        assert min(errors) < 1e-9 < 1e-5 < max(errors)
    assert all(float(row["value"]) >= float(row["fastest"]) > 0.0 for row in table)
    for row in table:
        # Tsit5 takes six a step and one at the start; DOP853 twelve, one fewer for a step that is tried again.
        low, high = (6, 6) if row["by"] == "diffrax-tsit5-call" else (11, 12)
        steps = float(row["accepted"]) + float(row["rejected"])
        assert steps > 10
        assert low * steps < float(row["evaluations"]) <= high * steps + 3
        assert 1e-2 < float(row["compile_seconds"]) < 60.0

    document = json.loads((tmp_path / "report.json").read_text())
    assert len(document["rows"]) == 18
    assert len(document["bars"]) == 4
    fastest = min((row for row in table if float(row["error"]) < 1e-6), key=lambda row: float(row["value"]))
    for name in ("report.md", "report.html"):
        text = (tmp_path / name).read_text()
        assert f"(6 digits). Fastest: {INTEGRATORS[fastest['by']].title} on Euler top." in text
        assert document["machine"] in text
    assert (tmp_path / "figures/euler-top.svg").stat().st_size < 150_000

    # The same again runs nothing; where rows are missing, only those are run.
    monkeypatch.setattr(integrators, "_first_run", pytest.fail)
    assert main(words) == 0
    assert "   0 rows" in capsys.readouterr().out
    monkeypatch.undo()
    document["rows"].pop()
    (tmp_path / "report.json").write_text(json.dumps(document))
    assert main(words) == 0
    assert "   1 rows" in capsys.readouterr().out
    assert (tmp_path / "report.csv").read_text().count("\n") == 19


def test_a_wrong_answer_ends_in_status_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    end = {name: np.array(value) for name, value in TOP.end.items()}
    end["w"][0] += 1e-3
    wrong = dataclasses.replace(TOP, exact=None, reference=end)
    monkeypatch.setattr(page, "SCENES", {"euler-top": wrong})
    told = ["report", "--quick", "--scene", "euler-top", "--method", "diffrax-tsit5-call", "--out", str(tmp_path)]
    assert main(told) == 1
    assert "IT DISAGREES" in capsys.readouterr().out
    assert "Not all methods were seen to find the same end" in (tmp_path / "report.md").read_text()


def test_rows_say_what_happened(tmp_path: Path) -> None:
    store = Store(tmp_path / "rows.json", ORIGIN)
    assert measure_scene(TOP, [Integrator("pretended", pretended)], SHORT, store) == {}
    rows = {row.numbers["setting"]: row for row in store}
    assert list(rows) == [1e-6, 1e-7, 1e-8, 1e-9]
    size = float(np.linalg.norm(TOP.end["w"]))
    assert rows[1e-6].numbers["error"] == pytest.approx(np.sqrt(3.0) * 1e-6 / max(1.0, size), rel=1e-6)
    assert rows[1e-6].numbers["repeats"] == 12
    assert [rows[1e-6].numbers[name] for name in ("accepted", "rejected", "evaluations")] == [3, 1, 24]
    assert np.isnan(rows[1e-9].numbers["error"])
    assert np.isnan(rows[1e-9].value)
    assert rows[1e-9].note == "did not reach the end"
    again = Store(tmp_path / "rows.json", ORIGIN)
    assert [row.record() for row in again] == [row.record() for row in store]


def test_a_method_that_cannot_run_a_scene_is_named(tmp_path: Path) -> None:
    def refusing(scene: Scene) -> SceneProgram:
        raise tx.ModelError("the rate depends on the pose\n  fix: another method")

    store = Store(tmp_path / "rows.json", ORIGIN)
    refused = measure_scene(TOP, [Integrator("refusing", refusing)], SHORT, store)
    assert refused == {"refusing": "the rate depends on the pose"}


def test_diffrax_in_one_call_is_compiled_as_one_small_function() -> None:
    """Otherwise the comparison would flatter us."""
    for name, small in (("diffrax-tsit5-call", True), ("diffrax-tsit5", False)):
        program = INTEGRATORS[name].build(TOP)
        text = jax.jit(program.solve).lower(program.start, jnp.asarray(1e-6)).compile().as_text()
        assert ('inlineable="false"' in text) == small
