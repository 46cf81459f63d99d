"""The sources of the solver's core, and the text that is made of them."""

import re
import shutil
import subprocess
from pathlib import Path

from twistax.solver.sources import amalgamation, fingerprint
from twistax.solver.text import kept_text


def test_the_text_is_made_of_these_sources() -> None:
    """Fix: python -m twistax.solver.text, with the package that it names."""
    assert fingerprint() in kept_text().splitlines()[0]


def test_the_sources_are_strict_c99_without_allocation(tmp_path: Path) -> None:
    compiler = shutil.which("gcc") or shutil.which("cc")
    assert compiler, "the tests of C code need a C compiler"
    source, target = tmp_path / "core.c", tmp_path / "core.o"
    source.write_text(amalgamation())
    flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wshadow", "-Werror", "-O2", "-c"]
    subprocess.run([compiler, *flags, str(source), "-o", str(target)], check=True)
    symbols = subprocess.run(["nm", str(target)], check=True, capture_output=True, text=True).stdout.split("\n")
    external = {line.split()[-1] for line in symbols if re.search(r" [TU] ", line)}
    assert {name for name in external if name.startswith("twx_")} == {
        *("twx_count", "twx_defaults", "twx_option_name", "twx_option_source", "twx_options_count"),
        *("twx_solve", "twx_linearised", "twx_workspace_size"),
        *(f"twx_phase_{name}" for name in ("work", "scratch", "states")),
        *(f"twx_transcribed_{name}" for name in ("values", "jacobians", "hessians", "derivatives", "retract")),
        *("twx_qp_defaults", "twx_qp_option_name", "twx_qp_option_source", "twx_qp_options_count"),
        *("twx_qp_solve", "twx_qp_workspace_size", "twx_form_memory", "twx_solve_members", "twx_linearised_members"),
        *("twx_solve_handler", "twx_linearised_handler", "twx_squares_handler", "twx_squares_solve"),
        *(f"twx_squares_{size}" for size in ("problem", "start", "result", "workspace")),
    }
    assert {name for name in external if not name.startswith("twx_")} <= {
        *(
            "log",
            "log10",
            "memcpy",
            "memset",
            "pow",
            "sched_yield",
            "sqrt",
            "time",
            "__stack_chk_fail",
            "_GLOBAL_OFFSET_TABLE_",
        ),
    }
    # No variables: what is in .data or .bss could be state.
    assert not [line for line in symbols if re.search(r" [BbDC] ", line)]
