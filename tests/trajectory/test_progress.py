"""Lines of solves, integrations and sweeps that take long."""

import contextlib
import io
import logging
import re
import sys
import threading
import time
from pathlib import Path

import pytest

import twistax as tx
from twistax import progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def double_integrator() -> tx.trajectory.Problem:
    p, v, u = tx.State("p"), tx.State("v"), tx.Control("u", min=-1.0, max=1.0)
    dynamics = tx.compile(tx.System(rates={p: v, v: u}))
    ends = {"initial": {p: 0.0, v: 0.0}, "final": {p: 1.0, v: 0.0}}
    return tx.trajectory.Problem(dynamics, tx.Minimize(tx.Time()), nodes=5, final_time=(0.5, 9.0), **ends)


def test_a_solve_prints_a_line_for_each_iteration() -> None:
    terminal = Terminal()
    result = double_integrator().solve(progress=tx.trajectory.Progress(cost="time {:.4f} s", stream=terminal))
    rows = re.findall(
        r"solve +iteration +(\d+)   time (\S+) s   violation +(\S+)(?:   step +(\S+))? .*\n", terminal.getvalue()
    )
    assert [int(row[0]) for row in rows][:9] == list(range(9))
    assert float(rows[-1][1]) == pytest.approx(result.final_time, abs=1e-4)
    assert float(rows[-1][2]) < 1e-6
    assert rows[0][3] == ""
    assert 0.0 < float(rows[-1][3]) < float(rows[1][3])


def test_lines_come_late_by_themselves_and_on_a_terminal_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_LIVE", "_PATIENCE"):
        monkeypatch.setattr(progress, name, 0.0)
    problem = double_integrator()
    for stream, options, lines in (
        (Terminal(), {}, True),
        (Terminal(), {"progress": False}, False),
        (Terminal(), {"callback": lambda iteration, cost, violation: None}, False),
        (io.StringIO(), {}, False),
    ):
        monkeypatch.setattr(sys, "stderr", stream)
        problem.solve(**options)
        assert ("iteration    1" in stream.getvalue()) == lines
    monkeypatch.undo()
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    problem.solve()  # within two seconds
    assert terminal.getvalue() == ""
    with pytest.raises(tx.TrajectoryError, match=r"progress expects True, False, None or a tx\.trajectory\.Progress"):
        problem.solve(progress=3)


def test_a_wait_has_a_line_with_its_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the innermost call, and the time it took at its end."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(progress, "_PATIENCE", 1.0)
    with progress.watched("integrate"), progress.watched("compile"):
        time.sleep(1.6)
    assert re.search(r"compile +\.\.\. +1 s\r", terminal.getvalue())
    assert re.search(r"compile +took 1\.\d s\n", terminal.getvalue())
    assert "integrate" not in terminal.getvalue()
    assert progress._WATCHED == []
    begin, text = time.perf_counter(), terminal.getvalue()
    with progress.watched("compile") as short:
        short._waited = True  # as part of a long call: a part of less than the patience has no line of its end
    assert time.perf_counter() - begin < 0.5
    assert terminal.getvalue() == text


def test_messages_are_records_where_logging_is_set_up(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(progress, "_LOGGED", 0.0)
    with caplog.at_level(logging.INFO, logger="twistax"):
        double_integrator().solve(progress=True)
    assert {record.name for record in caplog.records} == {"twistax"}
    assert "solve     iteration    0" in caplog.records[0].getMessage()
    with caplog.at_level(logging.WARNING, logger="twistax"):
        double_integrator().solve(progress=True)
    assert terminal.getvalue() == ""


def test_it_is_sparse_where_there_is_no_terminal() -> None:
    log = io.StringIO()
    line = tx.trajectory.Progress(stream=log)
    line(3, 27_000.0, 1e-3)
    line.close()
    assert log.getvalue() == ""


def test_a_bar_counts_what_this_run_does() -> None:
    terminal = Terminal()
    progress = tx.trajectory.Progress("sweep", stream=terminal)
    progress.begin -= 60.0
    progress.done(0.75, "40 members", before=0.5)
    assert "]  75% of 40 members, 60 s left" in terminal.getvalue()
    assert terminal.getvalue().count("=") == 18
    progress.done(0.5, "40 members", before=0.5)  # nothing says how long it takes


def test_a_format_of_something_else_is_refused() -> None:
    with pytest.raises(tx.TrajectoryError, match="mass"):
        tx.trajectory.Progress(cost="mass {:d}")


def test_public_calls_that_compile_or_import_show_their_seconds(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """What each call names, and that progress=False of an integration is silent."""
    calls: list[tuple[str, bool | None]] = []

    def record(what: str, progress: bool | None = None) -> contextlib.nullcontext[None]:
        calls.append((what, progress))
        return contextlib.nullcontext()

    x = tx.State("x")
    dynamics = tx.compile(tx.System(rates={x: -x}))
    solution = tx.integrate(dynamics, {"x": 1.0}, t1=1.0, dt=0.1, dense=True, save_at=[0.0, 1.0])
    monkeypatch.setattr(progress, "watched", record)
    solution.evaluate(0.5)
    solution.plot()
    tx.trajectory.linearize(dynamics, 0.0, {"x": 1.0})
    tx.trajectory.discretize(dynamics, 0.0, {"x": 1.0}, None, 0.1)
    dynamics.explain()
    dynamics.to_c(tmp_path)
    tx.mechanics.load(Path(__file__).parents[2] / "examples" / "arm.urdf")
    tx.integrate_phases([tx.Phase(dynamics, duration=0.2)], {"x": 1.0}, dt=0.1)
    tx.testing.check_joint(tx.mechanics.joints.Fixed("weld"))
    assert {what for what, _ in calls} >= {
        *("evaluate", "plot", "linearize", "discretize", "explain", "export", "load", "integrate", "check_joint")
    }
    calls.clear()
    circle = tx.System({x: 0.0 * x}, corrections={x: 1.0 - x})
    for call in (tx.lower(x + 1.0), lambda t, x: tx.compile(circle).project(t, x)):
        call(0.0, {"x": 1.0})
        assert ("compile", None) in calls
        calls.clear()
    lowered = tx.lower(x + 1.0)
    for _ in range(2):
        lowered(0.0, {"x": 1.0})
    assert calls == [("compile", None)], "a later call is short"
    monkeypatch.setattr(sys.modules["twistax.integrators.integrate"], "watched", record)
    calls.clear()
    tx.integrate(dynamics, {"x": 1.0}, t1=1.0, dt=0.1, progress=False)
    tx.integrate(dynamics, {"x": 1.0}, t1=1.0, dt=0.1)
    assert calls == [("integrate", False), ("integrate", None)]


def test_a_line_that_is_shown_begins_at_once_and_a_nested_one_does_not_repeat_its_seconds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = Terminal()
    with tx.trajectory.Progress("load", stream=terminal):
        assert "load      ..." in terminal.getvalue()
    monkeypatch.setattr(progress, "_PATIENCE", 1e-9)
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress.watched("compile") as outer, progress.watched("compile") as inner:
        outer._waited = inner._waited = True
    assert sys.stderr.getvalue().count("took") == 1


def test_lines_of_other_threads_are_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """The end of a call has a line, also while another thread makes a call of the same kind."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(progress, "_PATIENCE", 1e-9)
    ended = threading.Event()

    def other() -> None:
        with progress.watched("compile") as line:
            ended.wait(5.0)
            line._waited = True

    thread = threading.Thread(target=other)
    thread.start()
    with progress.watched("compile") as line:
        line._waited = True
    ended.set()
    thread.join()
    assert terminal.getvalue().count("took") == 2
