"""The line of a search."""

import io

import pytest

import twistax as tx


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_it_overwrites_one_line_on_a_terminal_and_is_sparse_elsewhere() -> None:
    terminal, log = Terminal(), io.StringIO()
    for stream in (terminal, log):
        progress = tx.trajectory.Progress("solve", cost="mass {:9,.0f} kg", stream=stream)
        progress.note("compiling ...")
        progress(3, 27_000.0, 1e-3)
        progress.close()
    assert "iteration    3" in terminal.getvalue()
    assert "1.0e-03" in terminal.getvalue()
    assert "27,000 kg" in terminal.getvalue()
    assert "\n" not in terminal.getvalue()
    assert log.getvalue() == ""


def test_a_bar_counts_what_this_run_does() -> None:
    terminal = Terminal()
    progress = tx.trajectory.Progress("sweep", stream=terminal)
    progress._begin -= 60.0
    progress.done(0.75, "40 members", before=0.5)
    assert "]  75% of 40 members, 60 s left" in terminal.getvalue()
    assert terminal.getvalue().count("=") == 18
    progress.done(0.5, "40 members", before=0.5)  # nothing says how long it takes


def test_a_format_of_something_else_is_refused() -> None:
    with pytest.raises(tx.TrajectoryError, match="mass"):
        tx.trajectory.Progress(cost="mass {:d}")
