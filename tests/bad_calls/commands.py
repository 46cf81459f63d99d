"""Bad uses of files and commands: exporters, saved systems, `python -m twistax`."""

import functools
import tempfile
from pathlib import Path

import numpy as np
from shared import X, cart
from table import bad

import twistax as tx
from twistax.__main__ import main


@functools.cache
def folder() -> Path:
    """A folder with a file of each wrong kind."""
    found = Path(tempfile.mkdtemp(prefix="twistax"))
    (found / "text").write_text("no archive")
    (found / "empty").write_bytes(b"")
    cart().save(found / "whole")
    (found / "half").write_bytes((found / "whole").read_bytes()[:300])
    (found / "mine.c").write_text("int main(void) {}")
    return found


def command(arguments: str) -> int:
    """`python -m twistax` with these arguments."""
    return main(arguments.split())


def to_c(**options):
    return cart().to_c(**({"directory": folder()} | options))


ROWS = [
    # files
    bad("a file that is not there", lambda: tx.load(folder() / "none"), "there is no file", "none"),
    bad("a file of text", lambda: tx.load(folder() / "text"), "text"),
    bad("an empty file", lambda: tx.load(folder() / "empty"), "empty"),
    bad("half a file", lambda: tx.load(folder() / "half"), "half"),
    bad("a folder for a file", lambda: tx.load(folder()), "cannot load", "twistax"),
    bad("a number for a file", lambda: tx.load(3), "load", "3"),
    bad("None for a file", lambda: tx.load(None), "load", "None"),
    bad("a file by another backend", lambda: tx.load(folder() / "whole", backend="xla"), "backend", "'xla'"),
    bad("a file in a folder that is not there", lambda: cart().save(folder() / "no" / "file"), "cannot save", "file"),
    bad("a file called None", lambda: cart().save(None), "save", "None"),
    # C
    bad("C called 1st", lambda: to_c(name="1st"), "name", "'1st'"),
    bad("C called math", lambda: to_c(name="math"), "name", "'math'"),
    bad("C called None", lambda: to_c(name=None), "name", "None"),
    bad("C in half precision", lambda: to_c(dtype=np.float16), "dtype", "float16"),
    bad("C in text", lambda: to_c(dtype="double precision"), "dtype", "'double precision'"),
    bad("C over a file of mine", lambda: to_c(name="mine"), "mine.c", "name="),
    bad("C in a file", lambda: to_c(directory=folder() / "text"), "cannot write", "text"),
    bad("C nowhere", lambda: to_c(directory=None), "directory", "None"),
    bad("C with derivatives by text", lambda: to_c(jacobian="x"), "jacobian", "'x'"),
    bad("C with derivatives by y", lambda: to_c(jacobian=("y",)), "wrt", "'y'"),
    bad("C with no points", lambda: to_c(points=[]), "points", "at least one"),
    bad("C with a point of one", lambda: to_c(points=[(0.0,)]), "points", "(0.0,)"),
    bad("C with a point of another shape", lambda: to_c(points=[(0.0, X, {"force": [1.0]})]), "u['force']", "(1,)"),
    bad("C with a negative tolerance", lambda: to_c(tolerance=-1.0), "tolerance", "-1.0"),
    bad("C with a tolerance of text", lambda: to_c(tolerance="tight"), "tolerance", "'tight'"),
    # CasADi
    bad("a CasADi function of what it has not", lambda: cart().to_casadi("rate"), "to_casadi", "'rate'", "rates"),
    bad("a CasADi function with two underscores", lambda: cart().to_casadi(name="a__b"), "name", "'a__b'"),
    bad("a CasADi function of a number", lambda: cart().to_casadi(3), "to_casadi", "3"),
    # commands
    bad("an unknown command", lambda: command("fly"), "'fly'", "demo"),
    bad("an unknown option", lambda: command("demo --fast"), "--fast"),
    bad("a start without a value", lambda: command("demo --initial height"), "'height'", "--help"),
    bad("a start of an unknown item", lambda: command("demo --initial altitude=3"), "'altitude=3'", "height"),
    bad("a start below the ground", lambda: command("demo --initial height=-3"), "height", "-3"),
    bad("a start of text", lambda: command("demo --initial height=high"), "height", "'high'"),
    bad("a start of NaN", lambda: command("demo --initial height=nan"), "height", "'nan'"),
    bad("a start with a number too few", lambda: command("demo --initial velocity=1:2"), "velocity", "'1:2'"),
    bad("a start given twice", lambda: command("demo --initial height=3,height=4"), "height", "twice"),
    bad("a start of another world", lambda: command("demo --initial height=1e9"), "height", "'1e9'"),
    bad("a tilt beyond upside down", lambda: command("demo --initial tilt=200"), "tilt", "200"),
    bad("too few nodes", lambda: command("demo --nodes 3"), "--nodes", "'3'"),
    bad("nodes of text", lambda: command("demo --nodes many"), "--nodes", "'many'"),
    bad("a negative seed", lambda: command("demo --guess-seed -1"), "--guess-seed"),
    bad("no iterations", lambda: command("demo --max-iterations 0"), "--max-iterations", "'0'"),
    bad("two reports", lambda: command("report --speed --stability"), "--stability", "--speed"),
    bad("an unknown scene", lambda: command("report --scene moon"), "'moon'", "heavy-top"),
    bad("an unknown method", lambda: command("report --method magic"), "'magic'"),
    bad("an unknown section", lambda: command("report --stability --only luck"), "'luck'"),
    bad("an unknown case", lambda: command("report --speed --case x"), "'x'"),
    bad("a page that is not there", lambda: command("report --renew nowhere.md"), "'nowhere.md'"),
]
