"""Functional mock-up units: validated and simulated by FMPy, beside `tx.integrate` and finite differences."""

import warnings
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from export_systems import MASS, STRICT, needs_compiler, run

import twistax as tx

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    fmpy = pytest.importorskip("fmpy")
    from fmpy.fmi3 import FMU3Model, FMU3Slave
    from fmpy.validation import validate_fmu

RK4, END, DT = tx.RKMK(tx.tableaus.RK4), 1.0, 0.02


def tumbling(order: Any = tx.LINEAR_FIRST) -> tx.Dynamics:
    """A body by its pose, a wheel by its rotation, a height that depends on time; units where leaves say so."""
    g = tx.State("g", group=tx.SE3, order=order, kind=tx.kinds.Pose("world", "body"))
    V, F = tx.State("V", (6,), kind=tx.Twist("body")), tx.Control("F", (6,), kind=tx.Wrench("body"))
    M = tx.Parameter("M", value=MASS if order is tx.LINEAR_FIRST else np.roll(MASS, 3, (0, 1)))
    R, w, h = tx.State("R", group=tx.SO3), tx.State("w", (3,)), tx.State("h")
    turn = tx.linalg.Cross(w, np.array([1.0, 2.0, 3.0]) * w)
    return tx.compile(
        tx.System(
            rates={
                g: V,
                V: tx.linalg.Solve(M, F - tx.lie.AdjointDual(V, M @ V, order=order)),
                R: w,
                w: turn,
                h: tx.Sin(tx.Time()) - 0.2 * h,
            },
            outputs={"power": V @ F, "place": g[:3, 3]},
        )
    )


START = {
    "g": np.asarray(tx.pose(position=[1.0, 2.0, 3.0], euler=[0.1, 0.2, 3.0])),
    "V": np.array([1.0, 0.5, -0.3, 2.0, 1.0, -5.0]),
    "R": np.eye(3),
    "w": np.array([0.1, 5.0, -0.1]),
    "h": 0.3,
}
WRENCH = {"F": np.array([0.1, 0.0, 0.2, 0.0, 0.01, 0.0])}


def written(folder: Path, dynamics: tx.Dynamics | None = None, **options: Any) -> Path:
    chosen = tumbling() if dynamics is None else dynamics
    return chosen.to_fmu(folder / "body.fmu", START, WRENCH, **({"steps": RK4, "dt": DT} | options))


def columns(solution: Any) -> dict[str, np.ndarray]:
    table = tx.columns.Columns().columns(solution)
    return {c.name: c.values for c in table if c.name != "t" and not c.name.startswith("F[")}


def largest_difference(records: Any, expected: dict[str, np.ndarray]) -> float:
    """Of all columns; a quaternion and its negative are one attitude."""
    worst = 0.0
    for name, values in expected.items():
        owner, _, entry = name.partition(".")
        sign = 1.0
        if entry.startswith("q"):
            sign = np.sign(sum(records[f"{owner}.q{k}"] * expected[f"{owner}.q{k}"] for k in "wxyz"))
        worst = max(worst, float(np.abs(sign * records[name] - values).max()))
    return worst


@needs_compiler
def test_fmpy_finds_nothing_wrong_and_flies_the_steps_of_integrate(tmp_path: Path) -> None:
    dynamics, save_at = tumbling(), np.linspace(0.0, END, 11)
    unit = written(tmp_path, dynamics)
    assert validate_fmu(str(unit)) == []
    options = {"u": WRENCH, "t1": END, "save_at": save_at}
    expected = columns(tx.integrate(dynamics, START, dt=DT, method=RK4, **options))
    flown = fmpy.simulate_fmu(
        str(unit), fmi_type="CoSimulation", stop_time=END, output_interval=0.1, output=list(expected)
    )
    assert largest_difference(flown, expected) < 1e-12
    assert flown["R.qw"].min() < -0.5  # it turns by more than half a turn
    for name in (name for name in expected if ".q" in name):  # no jumps between a quaternion and its negative
        assert np.abs(np.diff(flown[name])).max() < 0.6, name
    exact = columns(tx.integrate(dynamics, START, rtol=1e-12, atol=1e-12, **options))
    exchanged = fmpy.simulate_fmu(
        str(unit),
        fmi_type="ModelExchange",
        relative_tolerance=1e-12,
        stop_time=END,
        output_interval=0.1,
        output=list(exact),
    )
    assert largest_difference(exchanged, exact) < 1e-9


class Instance:
    """A unit that FMPy has loaded, its variables by name."""

    def __init__(self, unit: Path, folder: Path, kind: Any = FMU3Model) -> None:
        description = fmpy.read_model_description(str(unit))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        fmpy.extract(str(unit), str(folder))
        self.fmu = kind(guid=description.guid, unzipDirectory=str(folder), modelIdentifier="body", instanceName="one")
        self.fmu.instantiate()
        self.fmu.enterInitializationMode(startTime=0.4)
        self.fmu.exitInitializationMode()

    def get(self, *names: str) -> np.ndarray:
        return np.array(self.fmu.getFloat64([self.references[name] for name in names]))

    def set(self, name: str, value: float) -> None:
        self.fmu.setFloat64([self.references[name]], [value])

    def slopes(self, unknowns: list[str], known: str) -> np.ndarray:
        references = [self.references[name] for name in unknowns]
        return np.array(self.fmu.getDirectionalDerivative(references, [self.references[known]], [1.0]))


@needs_compiler
def test_derivatives_along_every_state_input_and_parameter(tmp_path: Path) -> None:
    one = Instance(written(tmp_path), tmp_path / "unit")
    unknowns = [name for name in one.references if name.startswith("der(")] + ["power", "place[1]"]
    knowns = [name for name in one.references if name not in {*unknowns, "time", "place[0]", "place[2]"}]
    assert len(knowns) == 7 + 6 + 4 + 3 + 1 + 6 + 36
    for known in knowns:
        (value,) = one.get(known)
        sides = []
        for step in (1e-5, -1e-5):
            one.set(known, value + step)
            sides.append(one.get(*unknowns))
        one.set(known, value)
        np.testing.assert_allclose(one.slopes(unknowns, known), (sides[0] - sides[1]) / 2e-5, atol=2e-7)


@needs_compiler
def test_bad_values_are_refused_and_states_are_kept(tmp_path: Path) -> None:
    one = Instance(written(tmp_path), tmp_path / "unit")
    before = one.get("V[0]", "h")
    for name, value in (("V[0]", np.nan), ("power", 1.0), ("time", 3.0), ("der(h)", 0.0)):
        with pytest.raises(fmpy.fmi1.FMICallException):
            one.set(name, value)
    np.testing.assert_array_equal(one.get("V[0]", "h"), before)
    state = one.fmu.getFMUState()
    one.set("h", 9.0)
    one.fmu.setFMUState(state)
    np.testing.assert_array_equal(one.get("V[0]", "h"), before)
    one.fmu.freeFMUState(state)
    other = Instance(written(tmp_path), tmp_path / "other", FMU3Slave)
    other.set("V[0]", 1e200)  # its square is beyond the range of numbers
    with pytest.raises(fmpy.fmi1.FMICallException):
        other.fmu.doStep(0.4, 0.1)
    np.testing.assert_array_equal(other.get("V[0]", "h", "time"), [1e200, 0.3, 0.4])


@pytest.mark.parametrize("order", [tx.LINEAR_FIRST, tx.ANGULAR_FIRST])
def test_names_units_and_start_values(order: Any, tmp_path: Path) -> None:
    unit = written(tmp_path, tumbling(order), compiler=None)
    assert unit.read_bytes() == written(tmp_path / "again", tumbling(order), compiler=None).read_bytes()
    with zipfile.ZipFile(unit) as archive:
        assert sorted(archive.namelist()) == ["modelDescription.xml", "sources/body.c", "sources/buildDescription.xml"]
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    entries = {entry.get("name"): entry for entry in root.iter("Float64")}
    linear, angular = (("V[0]", "V[5]"), ("V[5]", "V[0]"))[order is tx.ANGULAR_FIRST]
    units = {
        "g.x": "m",
        "g.qw": "1",
        linear: "m/s",
        angular: "1/s",
        linear.replace("V", "F"): "kg m/s2",
        angular.replace("V", "F"): "kg m2/s2",
        f"der({linear})": "m/s2",
        "power": "kg m2/s3",
        "h": None,
    }
    assert {name: entries[name].get("unit") for name in units} == units
    assert float(entries["g.y"].get("start")) == 2.0
    assert float(entries["h"].get("start")) == 0.3
    assert entries["F[2]"].get("causality") == "input"
    assert entries["M[1][1]"].get("causality") == "parameter"
    defined = {entry.get("name"): entry.find("BaseUnit").attrib for entry in root.iter("Unit")}
    assert defined["kg m2/s3"] == {"kg": "1", "m": "2", "s": "-3"}


@needs_compiler
def test_the_source_is_clean(tmp_path: Path) -> None:
    for steps in (None, RK4):
        with zipfile.ZipFile(written(tmp_path, steps=steps, compiler=None)) as archive:
            archive.extract("sources/body.c", tmp_path)
        made = run(["gcc", *STRICT, "-O0", "-c", str(tmp_path / "sources/body.c"), "-o", str(tmp_path / "body.o")])
        assert made.returncode == 0, made.stderr


def test_bad_arguments(tmp_path: Path) -> None:
    body = tumbling()
    with pytest.raises(tx.InputError, match=r"ends in \.fmu"):
        body.to_fmu(tmp_path / "body.zip")
    with pytest.raises(tx.InputError, match="not an element of SO3"):
        body.to_fmu(tmp_path / "body.fmu", {"R": 2.0 * np.eye(3)})
    with pytest.raises(tx.InputError, match=r"x0\['h'\] expects finite"):
        body.to_fmu(tmp_path / "body.fmu", {"h": np.nan})
    with pytest.raises(tx.ModelError, match="no C compiler 'no-cc'"):
        body.to_fmu(tmp_path / "body.fmu", compiler="no-cc")
    k = tx.Parameter("k", shape=())
    x = tx.State("x")
    decay = tx.compile(tx.System(rates={x: -k * x}))
    with pytest.raises(tx.ModelError, match="'k' has no value"):
        decay.to_fmu(tmp_path / "decay.fmu")
    loop = tx.compile(tx.System({x: -x}, corrections={x: -x}))
    with pytest.raises(tx.ModelError, match="corrections"):
        loop.to_fmu(tmp_path / "loop.fmu", steps=RK4)
