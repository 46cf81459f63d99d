"""The first picture of the demo: a free body that tumbles, simulated and drawn within seconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import twistax as tx

#: Of a solid box, kg and m: it turns about its middle axis, which is unstable (Euler's equations).
MASS, SIDES = 2.0, np.array([0.3, 0.8, 1.2])
START = {"g": tx.pose(position=[0.0, 0.0, 1.0]), "V": np.array([0.05, 0.0, 0.0, 0.01, 3.0, 0.0])}
SECONDS = 12.0


def flown() -> tx.Solution:
    """Twelve seconds of the motion of the box, with its energy and its angular momentum as outputs."""
    a, b, c = SIDES**2
    inertia = MASS / 12.0 * np.array([b + c, a + c, a + b])
    M = np.diag([MASS, MASS, MASS, *inertia])
    g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
    system = tx.System(rates={g: V, V: tx.linalg.Solve(M, -tx.lie.AdjointDual(V, M @ V))})
    times = np.linspace(0.0, SECONDS, 241)
    return tx.integrate(tx.compile(system), START, t1=SECONDS, dt=1e-2, save_at=times)


def draw(folder: Path) -> list[str]:
    """Simulate and draw it into the folder; returns lines that state what was written, or why not."""
    solution = flown()
    lines = [f"a box spun about its middle axis turns over, {int(solution.stats.steps)} steps of RKMK4"]
    try:
        solution.plot(units={"V": "m/s, rad/s"}).savefig(folder / "body.png", dpi=90)
        lines.append(str(folder / "body.png"))
    except tx.ModelError:
        lines.append("no figure: it needs matplotlib; get it with pip install 'twistax[plot]'")
    try:
        solution.show(folder / "body.html", bodies={"g": tx.view.Box(tuple(SIDES))})
        lines.append(str(folder / "body.html"))
    except tx.ModelError:
        lines.append("no animation: it needs viser; get it with pip install 'twistax[view]'")
    return lines
