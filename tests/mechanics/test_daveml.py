"""DAVE-ML: tables against SciPy, MathML against Python, the checks inside files, and what is refused where."""

import functools
import math
import os
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

import twistax as tx
from twistax.mechanics import DaveModel, load_daveml

SMALL = Path(__file__).parent / "models" / "small.dml"
#: The table T of the file, its axes mach, alpha, el.
AXES = [0.2, 0.6, 1.0], [-10.0, 0.0, 5.0, 20.0], [-20.0, 25.0]
VALUES = np.array([1, 2, 3, 5, 8, 13, 21, 34, -4, 1, 0.5, 2, 7, 1, 3, -2, 6, 2, 8, 1, 8, 2, 8, 4]).reshape(3, 4, 2)


@functools.cache
def small() -> DaveModel:
    return load_daveml(SMALL)


@functools.cache
def at() -> object:
    """All outputs of the small file and the slope of `chosen` by alpha, at arrays of (mach, alpha, el)."""
    leaves = {name: tx.State(name) for name in ("mach", "alpha", "el")}
    f = tx.lower(small()(leaves))
    slope = jax.grad(lambda a: f(0.0, {"mach": jnp.array(1.0), "alpha": a, "el": jnp.array(0.0)})["chosen"])
    return jax.jit(lambda z: (jax.vmap(lambda z: f(0.0, dict(zip(leaves, z))))(z), jax.vmap(slope)(z[:, 1])))


def drawn() -> np.ndarray:
    rng = np.random.default_rng(5)
    z = rng.uniform([-1.0, -20.0, -50.0], [4.0, 50.0, 50.0], (200, 3))
    z[:9, 0] = [1.0, 1.5, 2.0, 2.5, 3.0, 0.9, 3.1, 1.0 + 1e-12, 2.0 - 1e-12]
    z[9, 0] = np.nan
    z[:9, 1] = [0.0, 4.0, -1.0, -9.0, -2.0, 1e-9, -9.1, 2.0, -0.5]
    return z


def test_tables_are_looked_up_as_the_file_says() -> None:
    z = drawn()
    got, _ = at()(z)
    mach, alpha, el = z.T
    table = RegularGridInterpolator(AXES, VALUES, bounds_error=False, fill_value=None)
    inside = [np.clip(mach, 0.2, 1.0), np.clip(alpha, -10.0, 12.0), np.clip(el, -20.0, 25.0)]
    np.testing.assert_allclose(got["three"], table(np.stack(inside, -1)), rtol=0, atol=1e-12)
    beyond = [mach, np.clip(alpha, -10.0, 30.0), np.minimum(el, 25.0)]
    np.testing.assert_allclose(got["beyond"], table(np.stack(beyond, -1)), rtol=0, atol=1e-9)
    points = RegularGridInterpolator(([0.5, 1.0], [-20.0, 25.0]), [[1.0, 3.0], [4.0, 9.0]], bounds_error=False)
    within = np.stack([np.clip(mach, 0.5, 1.0), np.clip(el, -20.0, 25.0)], -1)
    np.testing.assert_allclose(got["points"], points(within), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(got["near"], np.clip(np.floor(mach + 0.5), 1.0, 3.0))
    np.testing.assert_array_equal(got["floor"], np.clip(np.floor(mach), 1.0, 3.0))
    np.testing.assert_array_equal(got["ceil"], np.clip(np.ceil(mach), 1.0, 3.0))


def test_calculations_choose_as_written_and_differentiate() -> None:
    z = drawn()
    got, slope = at()(z)
    gain = 2.5
    chosen = [math.sqrt(a) if a > 0 else gain if -9 < a < 0 and a != -1 else -gain for a in z[:, 1]]
    np.testing.assert_allclose(got["chosen"], chosen, rtol=1e-15)
    np.testing.assert_allclose(got["quadrant"], np.arctan2(z[:, 2], -1.0), rtol=1e-15)
    # A root is differentiated only where it is chosen.
    np.testing.assert_allclose(slope, [0.5 / math.sqrt(a) if a > 0 else 0.0 for a in z[:, 1]], rtol=1e-12)


def test_checks_of_a_file_run_and_say_what_is_off(tmp_path: Path) -> None:
    checks = small().check()
    assert [(c.shot, c.output) for c in checks] == [
        ("between", "three"), ("between", "steps"), ("halfway", "chosen"), ("halfway", "steps"),
    ]  # fmt: skip
    wrong = (
        SMALL.read_text()
        .replace(">1.3125<", ">1.3126<")
        .replace("<varID>gain</varID><signalValue>2.5", "<varID>gain</varID><signalValue>2")
    )
    (tmp_path / "wrong.dml").write_text(wrong)
    with pytest.raises(
        tx.ModelError, match=r"1 of 4 .*\n.*line 83, <signal>: three of 'between'.*gain is 2.5, expected 2.0"
    ):
        load_daveml(tmp_path / "wrong.dml").check()


def test_inputs_units_and_what_a_call_refuses() -> None:
    model = small()
    assert {name: signal.units for name, signal in model.inputs.items()} == {"mach": "nd", "alpha": "deg", "el": "deg"}
    assert model.inputs["alpha"].description == "Between the x axis and the air."
    numbers = model.values(mach=0.4, alpha=200.0, el=0.0)
    assert numbers["chosen"] == pytest.approx(math.sqrt(90.0))  # kept within the limits
    scaled = model({"mach": 0.4, "alpha": -2.0, "el": 0.0, "gain": tx.Parameter("k", value=7.0)}, outputs=["chosen"])
    assert float(tx.lower(scaled["chosen"])(0.0)) == 7.0
    for arguments, words in [
        ({"mach": 1.0}, r"2 inputs are missing: alpha \(angleOfAttack, deg\); el \(.*initially 0\)"),
        ({"mach": 1.0, "alfa": 1.0}, "did you mean 'alpha'"),
        ({"mach": np.ones(3), "alpha": 1.0, "el": 0.0}, "mach expects a scalar"),
    ]:
        with pytest.raises(tx.ModelError, match=words):
            model(arguments)
    for wrong in (np.nan, np.inf):
        with pytest.raises(tx.ModelError, match="alpha must be a finite number"):
            model.values(mach=0.4, alpha=wrong, el=0.0)
    with pytest.raises(tx.ModelError, match="have no finite value"):
        model.values(mach=0.4, alpha=-2.0, el=0.0, floor=1e308, outputs=["steps"])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<m:root/>", "<m:floor/>", "line {line}, <floor>: unknown operator 'floor'"),
        ("<m:ci>gain</m:ci><m:apply><m:and/>", "<m:ci>gian</m:ci><m:apply><m:and/>", "line {line}, <ci>.*mean 'gain'"),
        (">-20, 25<", ">-20, 25, 25<", "line {line}, <bpVals>: expected two or more increasing"),
        ("8, 4, <", "8, <", "line {line}, <dataTable>: expected 3 x 4 x 2 values, got 23"),
        ("8, 4, <", "8, 1_0 <", "line {line}, <dataTable>: expected finite numbers, got '1_0'"),
        ("8, 4, <", "8, &#1636; <", "line {line}, <dataTable>: expected finite numbers, got '\u0664'"),
        ('gtID="T"/></functionDefn>', 'gtID="S"/></functionDefn>', "line {line}, <griddedTableRef>: gtID 'S' is"),
        ('bpID="E"><bpVals', 'bpID="A"><bpVals', "line {line}, <breakpointDef>: bpID 'A' is already .* line 40"),
        ('varID="ceil">1', 'varID="floor">1', "line {line}, <function.*varID 'floor' has another"),
        ('varID="mach" interpolate="floor"', 'varID="steps" interpolate="floor"', "depends on itself"),
        ('interpolate="floor"', 'interpolate="cubicSpline"', "line {line}, <independentVarPts>: .*cubicSpline"),
        (">0.5 25 3<", ">0.6 25 3<", "line {line}, <ungriddedTableDef>: its 4 points do not fill a grid"),
        ("<m:otherwise>", "<m:piece>", "this is not XML"),
        ("<m:cn>-9</m:cn>", "<m:ci>alpha</m:ci><m:piecewise/>", "line {line}, <piecewise>: expected <otherwise>"),
        ("<m:plus/>", "<m:divide/>", "line {line}, <divide>: expected 2 operands, got 3"),
        ("<m:cn>100</m:cn>", "<m:cn>nan</m:cn>", "line {line}, <cn>: expected a finite number, got 'nan'"),
        ('minValue="-90"', 'minValue="91"', "line {line}, <variableDef.*minValue 91 is above maxValue 90"),
        ("<checkData>", "<switch/><checkData>", "line {line}, <switch>: is not supported"),
        ("<signalName>steps<", "<signalName>stpes<", "line {line}, <signal>: there is no variable 'stpes'"),
        ("nowhere/DAVEfunc.dtd\"", 'nowhere/DAVEfunc.dtd" [<!ENTITY a "1">]', "line 2: a document type or entity"),
        (">0.2, 0.6", ">&a; 0.6", "line {line}: unknown entity &a;"),
        ('max="12"', 'max="1&q;2"', "line {line}: unknown entity &q;"),
        ('type="e-notation">1<m:sep/>4', 'type="rational">1<m:sep/>0', "line {line}, <cn>: .*denominator"),
        ("</calculation>", "</calculation><calculation/>", "line {line}, <calculation>: has more than one"),
        ('max="12"', 'min="13" max="12"', "line {line}, <independentVarRef>: min 13 is above max 12"),
        ('<dependentVarPts varID="near">', '<independentVarRef varID="el"/><dependentVarPts varID="near">',
         "line {line}, <independentVarRef>: a function has either"),
        ("<signalUnits>deg", "<signalUnits>rad", "line {line}, <signal>: gives 'angleOfAttack' in 'rad'.* in 'deg'"),
        (' standalone="no"', ' encoding="shift_jis"', "this is not XML: multi-byte"),
        (' standalone="no"', ' encoding="foo"', "this is not XML: unknown encoding"),
    ],
)  # fmt: skip
def test_a_broken_file_is_refused_with_its_line(old: str, new: str, words: str, tmp_path: Path) -> None:
    text = SMALL.read_text()
    assert old in text
    broken = text.replace(old, new, 1)
    (tmp_path / "broken.dml").write_text(broken)
    # The line is where the element begins that the message names.
    tag, end = re.search(r"<(\w+)", words), text.index(old) + len(new)
    begin = max(broken.rfind(f"<{tag[1]}", 0, end), broken.rfind(f"<m:{tag[1]}", 0, end)) if tag else text.index(old)
    line = broken[:begin].count("\n") + 1
    with pytest.raises(tx.ModelError, match="(?s)" + words.replace("{line}", str(line))):
        load_daveml(tmp_path / "broken.dml")


def test_odd_roots_and_the_values_of_checks(tmp_path: Path) -> None:
    """The signal "b" is the variable of that name, though another has it as varID; what is no input is not given."""
    text = """<DAVEfunc><variableDef varID="a" name="b"/><variableDef varID="b" name="a"/>
      <variableDef varID="c" name="c" initialValue="2"/><variableDef varID="root" name="root"><calculation><math>
      <apply><root/><degree><cn>3</cn></degree><apply><times/><ci>c</ci><ci>a</ci></apply></apply></math></calculation>
      </variableDef><checkData><staticShot name="s"><checkInputs>
      <signal><signalName>b</signalName><signalValue>-4</signalValue></signal>
      <signal><signalName>a</signalName><signalValue>0</signalValue></signal>
      <signal><signalName>c</signalName><signalValue>2</signalValue></signal></checkInputs><checkOutputs>
      <signal><varID>root</varID><signalValue>-2</signalValue><tol>1e-12</tol></signal></checkOutputs>
      </staticShot></checkData></DAVEfunc>"""
    path = tmp_path / "root.dml"
    path.write_text(text)
    model = load_daveml(path)
    assert len(model.check()) == 1
    with pytest.raises(tx.ModelError, match="'a' given twice"):
        model.values({"a": 1.0}, a=2.0)
    path.write_text(text.replace("<signalValue>2<", "<signalValue>3<"))
    with pytest.raises(tx.ModelError, match="sets 'c' to 3, but 'c' is not an input"):
        load_daveml(path).check()


@pytest.mark.slow
def test_all_static_checks_of_the_f16() -> None:
    folder = os.environ.get("TWISTAX_NASA")
    if not folder:
        pytest.skip("TWISTAX_NASA names no folder with f16/*.dml")
    files = sorted((Path(folder) / "f16").glob("*.dml"))
    assert sum(len(load_daveml(path).check()) for path in files) == 198
