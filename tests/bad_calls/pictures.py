"""Bad uses of figures, of scenes in three dimensions and of lines that show how far something is."""

import jax
import jax.numpy as jnp
import numpy as np
from table import bad

import twistax as tx
from solutions import solution_of
from twistax.mechanics import Chain, Link, SpatialInertia, joints

view = tx.view
TIMES = np.array([0.0, 1.0, 2.0])
POSES = np.tile(np.eye(4), (3, 1, 1))
xs = {"g": jnp.asarray(POSES), "m": jnp.asarray(TIMES), "V": jnp.zeros((3, 6))}
flight = solution_of(TIMES, xs)
plain = tx.Solution(ts=flight.ts, xs={"m": xs["m"]}, stats=flight.stats, code=flight.code)
batch = jax.tree.map(lambda a: a[None], flight)
ball = SpatialInertia(mass=1.0, inertia=np.eye(3))
arm = Chain([Link(joints.Revolute("a", [0.0, 0.0, 1.0]), ball, np.eye(4))])
x = tx.State("x")
moving = tx.compile(tx.System({x: tx.Constant(1.0)}))


def show(**choices):
    """Nothing is written: what is wrong is said before."""
    return flight.show("nowhere/at/all.html", **choices)


def fly(progress):
    return tx.integrate_phases([tx.Phase(moving, duration=1.0)], {"x": 0.0}, dt=0.5, progress=progress)


ROWS = [
    bad("a body of no state", lambda: show(bodies={"h": ()}), "no state 'h'", "'g'"),
    bad("a body of a mass", lambda: show(bodies={"m": ()}), "'m'", "shape ()"),
    bad("a body that is a number", lambda: show(bodies=3), "bodies", "3"),
    bad("a body that looks like a word", lambda: show(bodies={"g": "box"}), "bodies['g']", "'b'"),
    bad("a body that looks like a number", lambda: show(bodies={"g": 1.0}), "bodies['g']", "1.0"),
    bad("a pair of a pose and a mass", lambda: show(bodies={("g", "m"): ()}), "('g', 'm')", "(4, 4)"),
    bad("a body's name that is a number", lambda: show(bodies={0: ()}), "0", "'g'"),
    bad("a mechanism that has other states", lambda: show(bodies=arm), "'q'", "'g'"),
    bad("an arrow of nothing", lambda: show(arrows={"T": view.Arrow()}), "'T'", "'g'"),
    bad("an arrow of a mass", lambda: show(arrows={"m": view.Arrow()}), "'m'", "shape ()"),
    bad("an arrow from nowhere", lambda: show(arrows={"V": view.Arrow("h")}), "'h'", "'g'"),
    bad("an arrow that is a number", lambda: show(arrows={"V": 1.0}), "arrows['V']", "1.0"),
    bad("trails of nothing", lambda: show(trails=["h"]), "'h'", "'g'"),
    bad("axes of nothing", lambda: show(axes="h"), "'h'", "'g'"),
    bad("up that is nowhere", lambda: show(up=(0.0, 0.0, 0.0)), "up", "(0.0, 0.0, 0.0)"),
    bad("up of two entries", lambda: show(up=(0.0, 1.0)), "up", "(0.0, 1.0)"),
    bad("up that is a word", lambda: show(up="z"), "up", "'z'"),
    bad("no time at all", lambda: show(seconds=0.0), "seconds", "0.0"),
    bad("a time without end", lambda: show(seconds=np.inf), "seconds", "inf"),
    bad("a time backwards", lambda: show(seconds=-1.0), "seconds", "-1.0"),
    bad("shapes that are numbers", lambda: show(shapes=[1.0]), "shapes", "1.0"),
    bad("a solution without poses", lambda: plain.show("a.html"), "no state is a pose", "'m'"),
    bad("a batch in three dimensions", lambda: batch.show("a.html"), "show", "batch"),
    bad("a figure of a batch", lambda: batch.plot(), "plot", "batch"),
    bad("a figure of nothing", lambda: flight.plot(["h"]), "'h'", "'g', 'm'"),
    bad("units of nothing", lambda: flight.plot(units={"h": "m"}), "'h'", "'g', 'm'"),
    bad("a box without depth", lambda: view.Box((1.0, 1.0, 0.0)), "lengths", "(1.0, 1.0, 0.0)"),
    bad("a box of two lengths", lambda: view.Box((1.0, 1.0)), "lengths", "(1.0, 1.0)"),
    bad("a box of words", lambda: view.Box("abc"), "lengths", "'abc'"),
    bad("a ball of radius zero", lambda: view.Sphere(0.0), "radius", "0.0"),
    bad("a ball of three radii", lambda: view.Sphere((1.0, 1.0, 1.0)), "radius", "(1.0, 1.0, 1.0)"),
    bad("a cylinder without end", lambda: view.Cylinder(1.0, np.inf), "length", "inf"),
    bad("a capsule of length zero", lambda: view.Capsule(1.0, 0.0), "length", "0.0"),
    bad("a cone that is a plane", lambda: view.Cone(1.0, 0.5 * np.pi), "half_angle", "1.57"),
    bad("a cone in degrees", lambda: view.Cone(1.0, 45.0), "half_angle", "45.0"),
    bad("an ellipsoid with a hole", lambda: view.Ellipsoid((1.0, np.nan, 1.0)), "radii", "nan"),
    bad("a place of two entries", lambda: view.Sphere(1.0, at=(0.0, 0.0)), "at", "(0.0, 0.0)"),
    bad("a place that is no pose", lambda: view.Sphere(1.0, at=2.0 * np.eye(4)), "at", "2."),
    bad("a colour by name", lambda: view.Sphere(1.0, color="red"), "color", "'red'"),
    bad("a colour from 0 to 1000", lambda: view.Sphere(1.0, color=(0, 0, 1000)), "color", "1000"),
    bad("more than opaque", lambda: view.Sphere(1.0, opacity=1.5), "opacity", "1.5"),
    bad("an arrow of no length", lambda: view.Arrow(scale=0.0), "scale", "0.0"),
    bad("an arrow from two entries", lambda: view.Arrow(at=(0.0, 1.0)), "at", "(0.0, 1.0)"),
    bad("an ellipsoid of no mass", lambda: view.Ellipsoid.of_inertia(0.0, np.zeros(3), np.eye(3)), "mass", "0.0"),
    bad("an ellipsoid of moments", lambda: view.Ellipsoid.of_inertia(1.0, np.zeros(3), np.ones(3)), "inertia", "1."),
    bad(
        "an ellipsoid of no inertia",
        lambda: view.Ellipsoid.of_inertia(1.0, np.zeros(3), np.zeros((3, 3))),
        "inertia",
        "0.",
    ),
    bad(
        "a link that looks like a word", lambda: Link(joints.Fixed("a"), ball, np.eye(4), shapes="box"), "shapes", "'b'"
    ),
    bad("a base that looks like a number", lambda: tx.mechanics.Mechanism(arm.links, shapes=1.0), "shapes", "1.0"),
    bad("progress that is a number", lambda: fly(3), "progress", "3"),
    bad("a picture of a large graph", lambda: tx.Concat(*[x + float(i) for i in range(200)]).svg(), "svg", "nodes"),
]
