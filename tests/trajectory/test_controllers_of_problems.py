"""Controllers in C of many problems: groups, cones, limits, free times, references, phases, continuous controls; their
iterates are Python's.
"""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_controller import pointing, regulator
from test_controllers_with_phases import runs_as_in_python, smooth, tumbling, two_burns
from test_phases_solved import problem as towards_a_wall

import twistax as tx
from twistax.mechanics import ConvexPolytope, signed_distance
from twistax.report.sections import cops, flights, problems
from twistax.trajectory import Collocation, Controller, GaussNewton, Linear, Mesh, Problem, Spline
from twistax.view import Cylinder

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not shutil.which("gcc"), reason="no gcc")]


def past_a_polytope() -> Problem:
    """A cylinder that flies past a polytope; the search for the nearest features has loops in branches."""
    T, V = tx.State("T", group=tx.SE3), tx.Control("V", shape=(6,))
    hull = ConvexPolytope(np.random.default_rng(0).normal(size=(8, 3)))
    clear = signed_distance(Cylinder(0.1, 0.4), hull, T) >= 0.1
    start, end = (
        np.block([[np.eye(3), np.array(p)[:, None]], [np.zeros((1, 3)), 1.0]])
        for p in ([-3.0, 0.1, 0.0], [3.0, 0.2, 0.3])
    )
    dynamics = tx.compile(tx.System(rates={T: V}, constraints=[clear]))
    return Problem(dynamics, tx.Minimize(running=V @ V), nodes=11, final_time=2.0, initial={T: start}, final={T: end})


GAUSS, NO_METHOD = Collocation(tx.tableaus.GAUSS_LEGENDRE4), dict.fromkeys(("method", "substeps"))
PROBLEMS: dict[str, Callable[[], Problem]] = {
    "regulator": regulator,
    "pointing": pointing,
    "brachistochrone": lambda: problems.brachistochrone(nodes=16),
    "Bryson-Denham": lambda: problems.bryson_denham(nodes=16),
    "cart-pole": lambda: problems.cart_pole(nodes=21),
    "cart-pole, Gauss-Newton": lambda: problems.cart_pole(nodes=21, hessian=GaussNewton()),
    "cart-pole, collocation": lambda: problems.cart_pole(
        nodes=11, transcription=Collocation(tx.tableaus.GAUSS_LEGENDRE4)
    ),
    "half turn on SO(3)": lambda: problems.reorientation(nodes=13),
    "landing on SE(3)": problems.landing,
    "Goddard": lambda: problems.goddard(nodes=21),
    **{
        f"rendezvous, {form}": lambda form=form: problems.rendezvous(form, nodes=13)
        for form in ("norm as cost", "norm below a slack", "squares below a slack")
    },
    "least time": lambda: problems.fastest(1.0, (0.5, 6.0), 1.0, nodes=13),
    "least time, up to 20 s": lambda: problems.fastest(1.0, (0.5, 20.0), 1.0, nodes=13),
    "robot arm": lambda: cops.robot_arm(nodes=13),
    "catalyst mixing": lambda: cops.catalyst_mixing(nodes=21),
    "quadrotor past spheres on SE(3)": lambda: flights.quadrotor(nodes=13),
    "Panda": lambda: flights.panda(nodes=8),
    "chain of masses": lambda: flights.chain_of_masses(3, nodes=11),
    "two burns, phases of free durations": two_burns,
    "extended boom, phases on SO(3)": tumbling,
    "phases with a state that begins anywhere": towards_a_wall,
    "phases, Gauss-Newton": lambda: towards_a_wall().with_phases([{"hessian": GaussNewton()}] * 2),
    "phases, collocation": lambda: tumbling().with_phases([{"transcription": GAUSS, **NO_METHOD}] * 2),
    "phases, linear controls": lambda: two_burns().with_phases([{"controls": Linear()}] * 2),
    "linear control": smooth,
    "linear control with a limit of its rate": lambda: problems.cart_pole(nodes=21, controls=Linear(rate=100.0)),
    "spline on SO(3)": lambda: Problem(**pointing().stated | {"controls": Spline(2)}),
    "cylinder past a polytope": past_a_polytope,
    "free node times": lambda: problems.brachistochrone(nodes=Mesh(12, free=True)),
}


def measured(controller: Controller) -> list[dict[str, np.ndarray]]:
    """The first nodes of the plan, entries of vectors changed by up to 2 %, poses as they are."""
    rng = np.random.default_rng(0)
    change = lambda a: a if a.ndim == 2 else a * (1.0 + 0.02 * rng.uniform(-1.0, 1.0, a.shape))  # noqa: E731
    return [{name: change(np.asarray(values[k])) for name, values in controller.phases[0].xs.items()} for k in range(3)]


@pytest.mark.parametrize("name", PROBLEMS)
def test_iterates_in_c_are_those_of_python(name: str, tmp_path: Path) -> None:
    """The test program compares three calls, with a shift after each where there is one: plans, multipliers, iterations
    and statuses.
    """
    controller = PROBLEMS[name]().controller(max_iterations=100)
    allowed = {"landing on SE(3)": 1e-4}.get(name, 1e-9)  # other plans determine their multipliers
    runs_as_in_python(controller, tmp_path, "-O1", states=measured(controller), multipliers=allowed)


def compared(controller: Controller, folder: Path, *flags: str, **options: Any) -> str:
    """What the test program of a controller prints."""
    files = controller.to_c(folder, name="loop", states=measured(controller), **options)
    target = folder / "test"
    command = ["gcc", "-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", str(files.source), str(files.test)]
    built = subprocess.run([*command, *flags, "-lm", "-o", str(target)], capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    ran = subprocess.run([str(target)], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


def below_a_cone() -> Problem:
    """A point mass in the plane that comes to rest, its force in a disc."""
    p, v = tx.State("p", shape=(2,)), tx.State("v", shape=(2,))
    force = tx.Control("force", shape=(2,))
    dynamics = tx.compile(tx.System(rates={p: v, v: force}, constraints={"thrust": tx.linalg.Norm(force) <= 1.0}))
    cost = tx.Minimize(10.0 * (p @ p + v @ v), running=p @ p + 0.1 * (force @ force))
    return Problem(dynamics, cost, nodes=15, final_time=3.0, initial={p: [1.0, -0.5], v: np.zeros(2)}, substeps=1)


#: Not among them: rendezvous, whose norms have a kink where the force vanishes; the landing, whose positions of 30 km
#: are known to some millimetres; Panda and catalyst mixing, whose optima are flat; the polytope, whose distance has
#: kinks (not solved in single precision, with statuses 3 and 5).
_NOT_IN_SINGLE = ("rendezvous", "landing", "Panda", "catalyst", "cylinder")
IN_SINGLE = [name for name in PROBLEMS if not name.startswith(_NOT_IN_SINGLE)]


@pytest.mark.parametrize("name", [*IN_SINGLE, "cone"])
def test_plans_in_single_precision_are_those_of_double(name: str, tmp_path: Path) -> None:
    """To 1e-3 of the largest entry: the square root of the error of first-order conditions, some 1e-6, which is what a
    plan may move by where the cost is flat to second order.
    """
    problem = below_a_cone() if name == "cone" else PROBLEMS[name]()
    flags = ("-Wdouble-promotion", "-Wfloat-conversion", "-fsanitize=undefined", "-fno-sanitize-recover")
    printed = compared(problem.controller(max_iterations=100), tmp_path, *flags, tolerance=1e-3, dtype=np.float32)
    assert "status 0" in printed
