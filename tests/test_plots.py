"""Pictures: the numbers that are drawn, their units, and the boxes and lines of a tree."""

import functools
import itertools
import sys
from html import escape
from pathlib import Path
from xml.etree import ElementTree

import jax
import numpy as np
import pytest

import twistax as tx
from solutions import solution_of
from twistax.trajectory.result.result import Trajectory

TIMES = np.linspace(0.0, 4.0, 9)


@functools.cache
def turning() -> dict[str, np.ndarray]:
    """A turn by 2 rad/s about z, which passes half a turn, and a motion along x."""
    poses = np.stack([np.asarray(tx.pose(position=[t, 0.0, 2.0], euler=[0.1, 0.2, 2.0 * t])) for t in TIMES])
    return {"g": poses, "v": np.stack([TIMES, -TIMES], axis=1), "A": np.zeros((9, 3, 3)), "m": 3.0 + TIMES}


def solution(**fields) -> tx.Solution:
    return solution_of(**{"ts": TIMES, "xs": turning(), "code": 0} | fields)


def panels(figure) -> dict:
    return {axes.get_title(): axes for axes in figure.axes}


def test_a_solution_in_one_line() -> None:
    found = panels(solution().plot(units={"v": "m/s"}))
    assert list(found) == ["position of g", "attitude of g", "v", "A", "m"]
    assert [axes.get_ylabel() for axes in found.values()] == ["m", "deg", "m/s", "SI", "SI"]
    assert {axes.get_xlabel() for axes in found.values()} == {"time, s"}
    lines = found["attitude of g"].get_lines()
    assert [line.get_label() for line in lines] == ["roll", "pitch", "yaw"]
    np.testing.assert_allclose(
        lines[2].get_ydata(), np.rad2deg(2.0 * TIMES), rtol=1e-6, atol=1e-9
    )  # it goes on beyond 180
    np.testing.assert_allclose(lines[1].get_ydata(), np.rad2deg(0.2), rtol=1e-6)
    np.testing.assert_array_equal(found["position of g"].get_lines()[0].get_ydata(), TIMES)
    assert [line.get_label() for line in found["v"].get_lines()] == ["v[0]", "v[1]"]
    assert len(found["A"].get_lines()) == 9


def test_a_solution_chooses_and_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    assert list(panels(solution().plot(["m"]))) == ["m"]
    assert list(panels(solution().plot("m", "v"))) == ["m", "v"]
    for names, units in ((["n"], {}), ([], {"n": "m"})):
        with pytest.raises(tx.InputError, match=r"'n'.*'g', 'v', 'A', 'm'"):
            solution().plot(*names, units=units)
    with pytest.raises(tx.InputError, match="save_at"):
        solution(ts=TIMES[:1]).plot()
    with pytest.raises(tx.InputError, match="batch"):
        solution(ts=np.stack([TIMES, TIMES])).plot()
    with pytest.raises(tx.InputError, match="traced"):
        jax.jit(lambda ts: solution(ts=ts).plot())(TIMES)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(tx.ModelError, match=r"twistax\[plot\]"):
        solution().plot()


@functools.cache
def satellite() -> tx.Solution:
    """A panel on a hinge and a boom on a slide of a hull that flies: entries of several units, and an output."""
    from twistax.mechanics import Link, Mechanism, SpatialInertia, joints

    body = SpatialInertia(mass=2.0, inertia=np.diag([1.0, 2.0, 3.0]))
    robot = Mechanism(
        [
            Link(joints.Free("hull"), body, np.eye(4)),
            Link(joints.Revolute("panel", (0.0, 1.0, 0.0)), body, np.eye(4), parent="hull"),
            Link(joints.Prismatic("boom", (1.0, 0.0, 0.0)), body, np.eye(4), parent="hull"),
        ],
        gravity=np.zeros(3),
    )
    dynamics = tx.compile(robot.system(controls=["panel", "boom"], outputs={"rpm": robot.qd[6] * 30.0 / np.pi}))
    assert dynamics.system.labels["tau"] == (("panel", "N m"), ("boom", "N"))
    start = {"q": np.array([0.1, 0.2]), "hull_position": np.eye(4), "qd": np.arange(8.0)}
    times = np.linspace(0.0, 0.1, 5)
    return tx.integrate(dynamics, start, t1=0.1, dt=0.01, u={"tau": np.zeros(2)}, save_at=times)


def test_entries_of_a_mechanism_are_named_by_joint_with_a_panel_for_each_unit() -> None:
    found = panels(satellite().plot())
    poses = ["position of hull_position", "attitude of hull_position"]
    assert sorted(found) == sorted([*poses, "q, rad", "q, m", "qd, m/s", "qd, rad/s"])
    assert [line.get_label() for line in found["qd, rad/s"].get_lines()] == ["hull x", "hull y", "hull z", "panel"]
    np.testing.assert_array_equal(found["qd, m/s"].get_lines()[3].get_ydata(), satellite().xs["qd"][:, 7])
    assert [line.get_label() for line in found["qd, m/s"].get_lines()][3] == "boom"
    assert found["qd, rad/s"].get_legend().get_bbox_to_anchor()._bbox.x0 == 1.0


def test_joints_and_outputs_are_drawn_by_name_in_units_that_are_asked_for() -> None:
    found = panels(satellite().plot("rpm", "panel", "hull", units={"panel": "deg"}))
    assert list(found) == ["rpm", "q of panel", "qd of panel", "qd of hull, m/s", "qd of hull, rad/s"]
    (line,) = found["q of panel"].get_lines()
    np.testing.assert_allclose(line.get_ydata(), np.rad2deg(satellite().xs["q"][:, 0]), rtol=1e-14)
    assert found["q of panel"].get_ylabel() == "deg"
    rpm = panels(satellite().plot("qd", units={"qd": "rpm"}))["qd, rpm"].get_lines()[3]
    np.testing.assert_allclose(rpm.get_ydata(), satellite().outputs["rpm"], rtol=1e-14)
    with pytest.raises(tx.InputError, match=r"'wheel'.*'panel'"):
        satellite().plot("wheel")


def test_declared_units_are_those_of_the_axes() -> None:
    h, w = tx.State("h", unit="m"), tx.State("w", shape=(3,), kind=tx.FreeVector("body"), unit="rad/s")
    g = tx.State("g", group=tx.SE3, order=tx.ANGULAR_FIRST, kind=tx.kinds.Pose("world", "body"))
    V, plain = tx.State("V", shape=(6,), kind=tx.Twist("body")), tx.State("plain")
    k = tx.Parameter("k", value=-1.0, unit="1/s")
    dynamics = tx.compile(tx.System(rates={h: k * h, w: k * w, g: V, V: k * V, plain: -plain}))
    start = {"h": 1.0, "w": np.ones(3), "g": np.eye(4), "V": np.ones(6), "plain": 1.0}
    solution = tx.integrate(dynamics, start, t1=1.0, dt=0.5, save_at=np.linspace(0.0, 1.0, 3))
    units = {title: axes.get_ylabel() for title, axes in panels(solution.plot()).items()}
    parts = {"position of g": "m", "attitude of g": "deg"}
    assert units == {"h": "m", "w": "rad/s", "V, rad/s": "rad/s", "V, m/s": "m/s", "plain": "SI"} | parts
    found = panels(solution.plot("w", "h", "V", units={"w": "deg/s", "h": "mm"}))
    np.testing.assert_allclose(found["w"].get_lines()[0].get_ydata(), np.rad2deg(solution.xs["w"][:, 0]), rtol=1e-14)
    np.testing.assert_allclose(found["h"].get_lines()[0].get_ydata(), 1e3 * solution.xs["h"], rtol=1e-14)
    assert [line.get_label() for line in found["V, rad/s"].get_lines()] == ["V[0]", "V[1]", "V[2]"]
    with pytest.raises(tx.InputError, match=r"'h' is in m, which is not converted to 'deg'; it expects 'm', 'mm'"):
        solution.plot("h", units={"h": "deg"})


def test_labels_of_a_system_are_checked_and_saved(tmp_path: Path) -> None:
    x, u = tx.State("x", shape=(2,)), tx.Control("u", min=-1.0, max=1.0)
    labels = {x: [("cart", "m"), ("pole", "rad")], "u": [("motor", "N")]}
    system = tx.System(rates={x: tx.Concat(x[1], u)}, labels=labels)
    assert system.labels == {"x": (("cart", "m"), ("pole", "rad")), "u": (("motor", "N"),)}
    tx.compile(system).save(tmp_path / "cart.twistax")
    assert tx.load(tmp_path / "cart.twistax").system.labels == system.labels
    for wrong in ({"y": [("a", "m")]}, {"x": [("a", "m")]}, {"x": [("a", "m", "x"), ("b", "m")]}):
        with pytest.raises(tx.ModelError, match="labels"):
            tx.System(rates={x: tx.Concat(x[1], u)}, labels=wrong)


def trajectory(t0: float = 0.0) -> Trajectory:
    """A plan by hand on a problem that nobody has solved."""
    p, v = tx.State("p", max=5.0), tx.State("v")
    u = tx.Control("u", shape=(2,), min=[-1.0, -2.0], max=[1.0, np.inf])
    dynamics = tx.compile(tx.System(rates={p: v, v: u[0] + u[1]}))
    problem = tx.trajectory.Problem(dynamics, tx.Minimize(tx.Time()), nodes=3, final_time=2.0, initial={p: 0.0, v: 0.0})
    xs, us = {"p": np.array([0.0, 0.5, 2.0]), "v": np.array([0.0, 1.0, 2.0])}, {"u": np.array([[1.0, 0.0], [0.5, 0.5]])}
    return Trajectory(problem, xs, us, t0 + np.array([0.0, 1.0, 2.0]), t0 + 2.0, {}, {})


def test_a_unit_for_each_half_of_a_control_draws_a_panel_each_with_its_limits() -> None:
    found = panels(trajectory().plot("u", units={"u": "N, N m"}))
    assert [(title, axes.get_ylabel()) for title, axes in found.items()] == [("u, N", "N"), ("u, N m", "N m")]
    assert [line.get_ydata()[0] for line in found["u, N"].get_lines()[2:]] == [-1.0, 1.0]


def test_a_plan_has_nodes_a_rollout_steps_and_limits() -> None:
    found = panels(trajectory().plot(units={"u": "N"}))
    assert list(found) == ["p", "v", "u"]
    rollout, nodes, limit = found["p"].get_lines()
    assert limit.get_label() == "limit 5"
    np.testing.assert_array_equal(nodes.get_xdata(), [0.0, 1.0, 2.0])
    np.testing.assert_allclose(rollout.get_ydata(), 0.5 * np.asarray(rollout.get_xdata()) ** 2, atol=1e-9)
    assert limit.get_ydata()[0] == 5.0
    steps = found["u"].get_lines()
    assert [steps[0].get_drawstyle(), found["u"].get_ylabel()] == ["steps-post", "N"]
    np.testing.assert_array_equal(steps[0].get_ydata(), [1.0, 0.5, 0.5])
    assert [line.get_ydata()[0] for line in steps[4:]] == [-2.0, -1.0, 1.0]


def test_phases_are_drawn_with_a_gap_between_them_and_multipliers_as_bars() -> None:
    from twistax.trajectory.result.pictures import drawn

    figure = drawn([trajectory(), trajectory(2.0)], ["u"], None, "two", {"u <= 1": np.array([0.1, -3.0])})
    found = panels(figure)
    np.testing.assert_array_equal(found["u"].get_lines()[0].get_ydata(), [1.0, 0.5, 0.5, np.nan, 1.0, 0.5, 0.5])
    assert [bar.get_width() for bar in found["largest multipliers"].patches] == [3.0]


def test_a_tree_as_svg() -> None:
    """A box for each node, also where it is read twice, a line for each place that reads it; boxes do not overlap."""
    g, V, M = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,)), tx.Parameter("M", shape=(6, 6))
    picture = tx.linalg.Solve(M, -tx.lie.AdjointDual(V, M @ V) + tx.lie.SE3Adjoint(g) @ V).svg()
    root = ElementTree.fromstring(picture)
    space = "{http://www.w3.org/2000/svg}"
    boxes = [{k: float(box.get(k)) for k in ("x", "y", "width", "height")} for box in root.iter(f"{space}rect")]
    assert (len(boxes), len(list(root.iter(f"{space}line")))) == (10, 12)
    for one, other in itertools.combinations(boxes, 2):
        if one["y"] == other["y"]:
            assert one["x"] + one["width"] < other["x"] or other["x"] + other["width"] < one["x"]
    assert float(root.get("width")) > max(box["x"] + box["width"] for box in boxes)
    assert "AdjointDual" in picture._repr_svg_()
    with pytest.raises(tx.ModelError, match="301"):
        tx.Concat(*[tx.Constant(float(i)) for i in range(300)]).svg()


def test_the_equations_of_a_system() -> None:
    g, V = tx.State("g", group=tx.SE3), tx.State("V_body", shape=(6,))
    u = tx.Control("u", shape=(6,))
    system = tx.System(rates={g: V, V: u - V}, outputs={"size": tx.linalg.Norm(V)}, constraints=[u <= 1.0])
    text, page = system._repr_latex_(), ElementTree.fromstring(f"<div>{system._repr_html_()}</div>")
    assert [["".join(cell.itertext()) for cell in row] for row in page[0]][1:] == [
        ["g", "state", "(4, 4)", "SpecialEuclidean"],
        ["V_body", "state", "(6,)", ""],
        ["u", "control", "(6,)", ""],
    ]
    assert "".join(page[1].itertext()).startswith("g˙=g(Vbody)∧Vbody˙=u−Vbodysize=‖Vbody‖")
    picture = system.svg()
    assert [name for name in ("g' = State V_body", "V_body' = Sub", "size = Norm") if escape(name) not in picture] == []
    assert r"\dot{g} &= g \left(V_{\mathrm{body}}\right)^{\wedge}" in text
    assert r"\dot{V_{\mathrm{body}}} &= u - V_{\mathrm{body}}" in text
    assert r"\mathrm{size} &=" in text
    assert text.count("{") == text.count("}")
    assert text.startswith(r"$\begin{aligned}")
