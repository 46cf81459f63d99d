"""Bad uses of `tx.integrate`: systems, starts, times, steps, tolerances, methods, controls, events, solutions."""

import functools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from shared import AT_REST, DECAY, INERTIA, TORQUE, U, X, body, cart, decay
from table import bad

import twistax as tx

TS, ROWS_OF_TABLE = [0.0, 1.0, 2.0], [1.0, 2.0, 3.0]
RK4, TSIT5 = tx.tableaus.RK4, tx.tableaus.TSIT5
s = tx.State("s")
position = tx.State("position")


def run(**options):
    """The cart for a second, with other options."""
    return tx.integrate(**({"dynamics": cart(), "x0": X, "t1": 1.0, "dt": 0.5, "u": U} | options))


def decays(**options):
    """The decay for a second, with other options."""
    return tx.integrate(**({"dynamics": decay(), "x0": DECAY, "t1": 1.0, "dt": 0.5} | options))


def turn(**options):
    """The body for a second, with other options."""
    default = {"dynamics": body(), "x0": AT_REST, "t1": 1.0, "dt": 0.5, "u": TORQUE, "params": INERTIA}
    return tx.integrate(**(default | options))


def adaptive(**options):
    """The decay with tolerances, with other options."""
    return decays(**({"dt": None, "rtol": 1e-6} | options))


def free(**options):
    """The body with tolerances, with other options."""
    return turn(**({"dt": None, "rtol": 1e-6} | options))


@functools.cache
def made():
    return tx.simulator(decay(), DECAY, t1=1.0, dt=0.5)


@functools.cache
def solution():
    return decays(dense=True)


def held(ts, values=(1.0, 2.0, 3.0)):
    return {"force": tx.ZeroOrderHold(ts, values)}


def ramp(ts, values=(1.0, 2.0, 3.0)):
    return {"force": tx.FirstOrderHold(ts, values)}


ROWS = [
    # the system
    bad("a plain function", lambda: decays(dynamics=lambda t, x: x), "integrate", "function", "tx.compile"),
    bad("text", lambda: decays(dynamics="decay"), "integrate", "str", "tx.compile"),
    bad("a system that is not compiled", lambda: decays(dynamics=decay().system), "integrate", "System", "tx.compile"),
    bad("an expression", lambda: decays(dynamics=-s), "integrate", "Neg", "tx.compile"),
    bad("None as a system", lambda: decays(dynamics=None), "integrate", "NoneType", "tx.compile"),
    bad("a term of diffrax", lambda: decays(dynamics=diffrax.ODETerm(lambda t, y, a: y)), "integrate", "ODETerm"),
    # starts
    bad("a start as a list", lambda: decays(x0=[1.0]), "x0", "list"),
    bad("a start as an array", lambda: decays(x0=np.ones(4)), "x0", "ndarray"),
    bad("a start without a state", lambda: decays(x0={"x": 1.0}), "'v'", "missing"),
    bad("a misspelt start", lambda: run(x0=X | {"velocty": 1.0}), "'velocty'", "'velocity'"),
    bad("a start of another shape", lambda: decays(x0=DECAY | {"v": np.ones(2)}), "x0['v']", "(3,)", "(2,)"),
    bad("a batch of starts", lambda: decays(x0={"x": np.ones(4), "v": np.ones((4, 3))}), "x0['x']", "(4,)"),
    bad("a start of text", lambda: decays(x0=DECAY | {"x": "1"}), "x0['x']", "'1'"),
    bad("a start of None", lambda: decays(x0=DECAY | {"x": None}), "x0['x']", "None"),
    bad("a complex start", lambda: decays(x0=DECAY | {"x": 1j}), "x0['x']", "complex"),
    bad("a start of NaN", lambda: decays(x0=DECAY | {"x": np.nan}), "x0['x']", "nan"),
    bad("an infinite start", lambda: decays(x0=DECAY | {"v": [1.0, np.inf, 0.0]}), "x0['v']", "inf"),
    bad("a pose that is none", lambda: turn(x0=AT_REST | {"g": 2.0 * np.eye(4)}), "x0['g']", "SE3", "off by"),
    bad("a reflected pose", lambda: turn(x0=AT_REST | {"g": np.diag([1.0, 1.0, -1.0, 1.0])}), "x0['g']", "SE3"),
    bad(
        "a pose a little off",
        lambda: turn(x0=AT_REST | {"g": np.diag([1.0, 1.0, 1.01, 1.0])}),
        "x0['g']",
        "off by 0.02",
    ),
    bad("a last row", lambda: turn(x0=AT_REST | {"g": np.eye(4) + 0.02 * np.eye(4, k=-3)}), "x0['g']", "off by 0.02"),
    bad("a pose of NaN", lambda: turn(x0=AT_REST | {"g": np.nan * np.eye(4)}), "x0['g']", "nan"),
    bad("a quaternion for a pose", lambda: turn(x0=AT_REST | {"g": [1.0, 0.0, 0.0, 0.0]}), "x0['g']", "(4, 4)", "(4,)"),
    # times
    bad("an end of NaN", lambda: decays(t1=np.nan), "t1", "nan"),
    bad("an infinite end", lambda: decays(t1=np.inf), "t1", "inf"),
    bad("an end of text", lambda: decays(t1="1"), "t1", "'1'"),
    bad("an end of None", lambda: decays(t1=None), "t1", "None"),
    bad("two ends", lambda: decays(t1=[1.0, 2.0]), "t1", "[1.0, 2.0]"),
    bad("a complex end", lambda: decays(t1=1j), "t1", "1j"),
    bad("a start at NaN", lambda: decays(t0=np.nan), "t0", "nan"),
    bad("a start time of text", lambda: decays(t0="0"), "t0", "'0'"),
    bad("a start time of None", lambda: decays(t0=None), "t0", "None"),
    bad("start times", lambda: decays(t0=np.zeros(2)), "t0", "array([0., 0.])"),
    bad("no steps at all", lambda: decays(dt=None), "dt", "steps", "rtol"),
    bad("both dt and steps", lambda: decays(steps=3), "dt", "steps"),
    bad("a step of zero", lambda: decays(dt=0.0), "dt", "0"),
    bad("a step backwards", lambda: decays(dt=-0.1), "dt", "-0.1"),
    bad("an infinite step", lambda: decays(dt=np.inf), "dt", "inf"),
    bad("a step of NaN", lambda: decays(dt=np.nan), "dt", "nan"),
    bad("a step of text", lambda: decays(dt="0.1"), "dt", "'0.1'"),
    bad("steps of several lengths", lambda: decays(dt=[0.1, 0.2]), "dt", "[0.1, 0.2]"),
    bad("a truth value as a step", lambda: decays(dt=True), "dt", "True"),
    bad("half a step", lambda: decays(dt=None, steps=2.5), "steps", "2.5"),
    bad("no step", lambda: decays(dt=None, steps=0), "steps", "0"),
    bad("steps of text", lambda: decays(dt=None, steps="3"), "steps", "'3'"),
    bad("saved times that are not sorted", lambda: decays(save_at=[0.5, 0.2]), "save_at", "0.5", "0.2"),
    bad("saved times outside", lambda: decays(save_at=[0.5, 1.5]), "save_at", "[0, 1]", "1.5"),
    bad("saved times before", lambda: adaptive(save_at=[-0.5, 0.5]), "save_at", "[0, 1]", "-0.5"),
    bad("no saved times", lambda: decays(save_at=[]), "save_at", "(0,)"),
    bad("a number of saved times", lambda: decays(save_at=10), "save_at", "()"),
    bad("saved times of NaN", lambda: decays(save_at=[0.0, np.nan]), "save_at", "nan"),
    bad("saved times of text", lambda: decays(save_at="all"), "save_at", "'all'"),
    bad("saved times in a column", lambda: decays(save_at=np.zeros((2, 1))), "save_at", "(2, 1)"),
    bad("a SaveAt of diffrax", lambda: decays(save_at=diffrax.SaveAt(t1=True)), "save_at", "SaveAt"),
    bad("dense as text", lambda: decays(dense="no"), "dense", "'no'"),
    bad("throw as text", lambda: decays(throw="no"), "throw", "'no'"),
    # tolerances
    bad("a negative tolerance", lambda: adaptive(rtol=-1e-6), "rtol", "-1e-06"),
    bad("a tolerance of NaN", lambda: adaptive(rtol=np.nan), "rtol", "nan"),
    bad("a tolerance below round-off", lambda: adaptive(rtol=1e-16), "rtol", "1e-16"),
    bad("a tolerance of text", lambda: adaptive(rtol="1e-6"), "rtol", "'1e-6'"),
    bad("a truth value as a tolerance", lambda: adaptive(rtol=True), "rtol", "True"),
    bad("tolerances by state", lambda: adaptive(rtol={"x": 1e-6}), "rtol", "dict"),
    bad("a list of tolerances", lambda: adaptive(rtol=[1e-6, 1e-6]), "rtol", "(2,)"),
    bad("atol alone", lambda: adaptive(rtol=None, atol=1e-6), "atol", "rtol"),
    bad("a negative atol", lambda: adaptive(atol=-1.0), "atol", "-1"),
    bad("an atol of NaN", lambda: adaptive(atol=np.nan), "atol", "nan"),
    bad("an atol of a state it has not", lambda: adaptive(atol={"x": 1.0, "v": 1.0, "w": 1.0}), "atol", "'w'"),
    bad("an atol without a state", lambda: adaptive(atol={"x": 1.0}), "atol", "'v'"),
    bad("a pair for a vector", lambda: adaptive(atol=(1e-6, 1e-6)), "atol", "(2,)"),
    bad("an atol of text", lambda: adaptive(atol="1e-6"), "atol", "'1e-6'"),
    bad("a pair with None", lambda: free(atol={"g": (1e-6, None), "V": 1e-6}), "atol", "'g'", "None"),
    bad("a pair of a tolerance below zero", lambda: free(atol={"g": (1e-6, -1.0), "V": 1e-6}), "atol", "'g'", "-1"),
    bad("three tolerances for a pose", lambda: free(atol={"g": np.ones(3), "V": 1e-6}), "atol", "'g'", "(6,)", "(3,)"),
    bad("steps with tolerances", lambda: adaptive(steps=3), "steps", "rtol"),
    bad("a control of steps without tolerances", lambda: decays(control=tx.StepControl()), "control", "rtol"),
    bad(
        "a control of diffrax", lambda: adaptive(control=diffrax.PIDController(1e-6, 1e-6)), "control", "PIDController"
    ),
    bad("a control by name", lambda: adaptive(control="pid"), "control", "'pid'"),
    bad("jumps of NaN", lambda: adaptive(jumps=[0.5, np.nan]), "jumps", "nan"),
    bad("jumps of text", lambda: adaptive(jumps="0.5"), "jumps", "'0.5'"),
    bad("a single jump", lambda: adaptive(jumps=0.5), "jumps", "0.5"),
    bad("jumps that are not sorted", lambda: adaptive(jumps=[0.7, 0.5]), "jumps", "0.7", "0.5"),
    bad("safety above one", lambda: tx.StepControl(safety=2.0), "safety", "2.0"),
    bad("a safety of text", lambda: tx.StepControl(safety="high"), "safety", "'high'"),
    bad("no steps allowed", lambda: tx.StepControl(max_steps=0), "max_steps", "0"),
    bad("a factor that shrinks", lambda: tx.StepControl(factormax=0.5), "factormax", "0.5"),
    bad("dtmax below dtmin", lambda: tx.StepControl(dtmin=1.0, dtmax=0.5), "dtmax", "0.5"),
    bad("a factor that grows", lambda: tx.StepControl(factormin=1.0), "factormin", "1.0"),
    bad("a factor below zero", lambda: tx.StepControl(factormin=-0.1), "factormin", "-0.1"),
    bad(
        "coefficients that cancel",
        lambda: tx.StepControl(pcoeff=-0.3, icoeff=0.2),
        "pcoeff + icoeff + dcoeff",
        "positive",
    ),
    bad("a dtmin of zero", lambda: tx.StepControl(dtmin=0.0), "dtmin", "0.0"),
    bad("a dtmin of NaN", lambda: tx.StepControl(dtmin=np.nan), "dtmin", "nan"),
    # methods
    bad("a method by name", lambda: decays(method="RK4"), "method", "'RK4'", "tx.RKMK"),
    bad("a tableau as a method", lambda: decays(method=RK4), "method", "ButcherTableau", "tx.RKMK"),
    bad("a class as a method", lambda: decays(method=tx.RKMK), "method", "RKMK", "tx.RKMK("),
    bad("a solver of diffrax", lambda: decays(method=diffrax.Tsit5()), "method", "Tsit5", "tx.RKMK"),
    bad("a method without an estimate", lambda: adaptive(method=tx.RKMK(RK4)), "RK4", "its own steps", "TSIT5"),
    bad("a tableau by name", lambda: tx.RKMK("RK4"), "RKMK", "'RK4'", "tx.tableaus.RK4"),
    bad("an implicit tableau for RKMK", lambda: tx.RKMK(tx.tableaus.RADAU_IIA3), "RKMK", "Radau"),
    bad("an explicit tableau for an implicit method", lambda: tx.ImplicitRKMK(RK4), "ImplicitRKMK", "RK4"),
    bad("a chart by name", lambda: tx.RKMK(RK4, "exponential"), "RKMK", "'exponential'", "tx.charts"),
    bad("a chart as a class", lambda: tx.RKMK(RK4, tx.charts.Ambient), "RKMK", "Ambient", "tx.charts"),
    bad("half a commutator", lambda: tx.charts.Exponential(0.5), "commutators", "0.5"),
    bad("an order that Magnus has not", lambda: tx.Magnus(5), "Magnus", "5"),
    bad("an inner method by name", lambda: tx.Magnus(4, "RK4"), "Magnus", "'RK4'"),
    bad(
        "rates that Magnus does not take",
        lambda: tx.integrate(
            tx.compile(tx.System({(R := tx.State("R", group=tx.SO3)): R[:, 0]})),
            {"R": np.eye(3)},
            t1=1.0,
            dt=0.5,
            method=tx.Magnus(),
        ),
        "Magnus",
        "'R'",
    ),
    bad("a tableau for CommutatorFree", lambda: tx.CommutatorFree(RK4), "CommutatorFree", "RK4"),
    bad("a splitting without bodies", lambda: tx.Splitting(tx.compositions.STRANG, []), "Splitting", "[]"),
    bad("a splitting by name", lambda: tx.Splitting("strang", [tx.FreeParticle("x", "v")]), "Splitting", "'strang'"),
    bad("a splitting of a number", lambda: tx.Splitting(tx.compositions.STRANG, 3), "Splitting", "3"),
    bad(
        "a body of a state it has not",
        lambda: run(method=tx.Splitting(tx.compositions.STRANG, tx.FreeParticle("place", "velocity"))),
        "'place'",
        "position",
    ),
    bad("a body without a velocity", lambda: tx.FreeBody("g", inertia=np.ones(6)), "FreeBody", "velocity"),
    bad("an inertia of text", lambda: tx.FreeBody("g", "V", inertia=[None]), "FreeBody", "inertia", "None"),
    bad(
        "a tableau whose weights do not add up",
        lambda: tx.tableaus.ButcherTableau("t", 1, [[0.0]], [0.5], [0.0]),
        "'t'",
        "b",
        "0.5",
    ),
    bad(
        "a tableau that is not explicit", lambda: tx.tableaus.ButcherTableau("t", 1, [[1.0]], [1.0], [1.0]), "'t'", "a"
    ),
    bad("a tableau of text", lambda: tx.tableaus.ButcherTableau("t", 1, "a", [1.0], [0.0]), "'t'", "'a'"),
    bad("a composition that does not add up", lambda: tx.compositions.Composition("c", 2, [0.5]), "'c'", "0.5"),
    # controls
    bad("controls that are missing", lambda: run(u=None), "'force'", "missing"),
    bad("controls as an array", lambda: run(u=np.ones(1)), "u", "ndarray"),
    bad("controls as a number", lambda: run(u=1.0), "u", "float"),
    bad("controls as text", lambda: run(u="force"), "u", "str"),
    bad("a misspelt control", lambda: run(u={"forc": 1.0}), "'forc'", "'force'"),
    bad("a control of NaN", lambda: run(u={"force": np.nan}), "u['force']", "nan"),
    bad("a control of another shape", lambda: run(u={"force": [1.0]}), "u['force']", "(1,)"),
    bad("a bare table", lambda: run(u=tx.ZeroOrderHold(TS, ROWS_OF_TABLE)), "u must be a dict", "ZeroOrderHold"),
    bad("a function of one control", lambda: run(u={"force": lambda t: 1.0}), "u['force']", "one function"),
    bad("a function of two arguments", lambda: run(u=lambda t, x: U), "u", "t, x"),
    bad("a function of no arguments", lambda: run(u=lambda: U), "u", "()"),
    bad("a function that gives a list", lambda: run(u=lambda t: [t]), "u", "list"),
    bad("a function that gives nothing", lambda: run(u=lambda t: None), "u", "None"),
    bad("a function that gives another name", lambda: run(u=lambda t: {"forc": t}), "'forc'", "'force'"),
    bad("a function that leaves one out", lambda: run(u=lambda t: {}), "'force'", "missing"),
    bad(
        "a function that gives another shape", lambda: run(u=lambda t: {"force": jnp.ones(2)}), "u(t)['force']", "(2,)"
    ),
    bad("a function that gives text", lambda: run(u=lambda t: {"force": "1"}), "u(t)['force']", "'1'"),
    bad("a function that gives NaN", lambda: run(u=lambda t: {"force": jnp.nan}), "u(t)['force']", "nan"),
    bad(
        "a function that asks for the number",
        lambda: run(u=lambda t: {"force": 1.0 if t < 0.5 else 2.0}),
        "u",
        "t",
        "jnp.where",
    ),
    bad("a function with NumPy inside", lambda: run(u=lambda t: {"force": np.sin(t)}), "u", "t", "jax.numpy"),
    bad("a hold that begins late", lambda: run(u=held([0.5, 1.0, 2.0])), "u['force']", "0.5", "t0 = 0"),
    bad(
        "a hold that begins late, with tolerances",
        lambda: run(u=held([0.5, 1.0, 2.0]), dt=None, rtol=1e-6),
        "u['force']",
        "0.5",
        "t0 = 0",
    ),
    bad("a ramp that begins late", lambda: run(u=ramp([0.5, 1.0, 2.0])), "u['force']", "0.5", "t0 = 0"),
    bad("a ramp that ends early", lambda: run(u=ramp([0.0, 0.2, 0.5])), "u['force']", "0.5", "t1 = 1"),
    bad("a table of times that fall", lambda: held([0.0, 2.0, 1.0]), "ZeroOrderHold", "2.0 before 1.0"),
    bad("a table of one time twice", lambda: held([0.0, 1.0, 1.0]), "ZeroOrderHold", "1.0 before 1.0"),
    bad("a ramp of a bare time", lambda: ramp(0.0, [1.0]), "FirstOrderHold", "ts", "()"),
    bad("a table of NaN", lambda: held([0.0, 1.0, np.nan]), "ZeroOrderHold", "ts"),
    bad("a table of text", lambda: held("ts"), "ZeroOrderHold", "ts", "'ts'"),
    bad("a table of values of text", lambda: held(TS, "values"), "ZeroOrderHold", "values", "'values'"),
    bad("a table of None", lambda: held(TS, [1.0, None, 2.0]), "ZeroOrderHold", "values", "None"),
    bad("a complex table", lambda: held(TS, [1j, 1.0, 2.0]), "ZeroOrderHold", "values", "complex"),
    bad("a table with infinite values", lambda: held(TS, [np.inf, 1.0, 2.0]), "ZeroOrderHold", "values", "finite"),
    bad("a table of another length", lambda: held(TS, [1.0, 2.0]), "ZeroOrderHold", "3", "(2,)"),
    bad("a ramp of one point", lambda: ramp([0.0], [1.0]), "FirstOrderHold", "(1,)"),
    bad("a table of values of another shape", lambda: run(u=held(TS, np.ones((3, 2)))), "u['force']", "(2,)"),
    # parameters
    bad("a misspelt parameter", lambda: run(params={"mas": 1.0}), "'mas'", "'mass'"),
    bad("a parameter of NaN", lambda: run(params={"mass": np.nan}), "params['mass']", "nan"),
    bad("a parameter that is missing", lambda: turn(params=None), "'J'", "no value"),
    bad("parameters as a number", lambda: run(params=2.0), "params", "float"),
    # events
    bad("an expression as an event", lambda: decays(event=s), "event", "tx.Event"),
    bad("a number among events", lambda: decays(event=[3.0]), "event", "3.0", "tx.Event"),
    bad("a function as an event", lambda: decays(event=lambda t, x, u, p: x["x"]), "event", "function", "tx.Event"),
    bad("an event that ends by text", lambda: tx.Event(s, terminal="no"), "terminal", "'no'"),
    bad("an event at the start by text", lambda: tx.Event(s, at_start="stop"), "at_start", "tx.AtStart"),
    bad("room for crossings without events", lambda: decays(max_crossings=3), "max_crossings", "event"),
    bad("saved times the wrong way", lambda: decays(t0=1.0, t1=0.0, save_at=[0.2, 0.5]), "save_at", "0.2 before 0.5"),
    bad("no events", lambda: decays(event=[]), "event", "[]"),
    bad("an event of a vector", lambda: tx.Event(tx.State("v", 3)), "Event", "(3,)"),
    bad("an event of a number", lambda: tx.Event(3.0), "Event", "3.0"),
    bad("an event of an equality", lambda: tx.Event(s == 0.0), "Event", "s == 0", "a - b"),
    bad("a condition with a direction", lambda: tx.Event(s < 0.0, direction=True), "Event", "s < 0", "direction"),
    bad("an event in a direction of zero", lambda: tx.Event(s, 0), "direction", "0"),
    bad("an event in a direction of text", lambda: tx.Event(s, "down"), "direction", "'down'"),
    bad("an event of a state it has not", lambda: decays(event=tx.Event(s)), "'s'", "event"),
    bad("an event of two numbers", lambda: decays(event=tx.Event(lambda t, x, u, p: x["v"])), "event 0", "(3,)"),
    bad("an event of whole numbers", lambda: decays(event=tx.Event(lambda t, x, u, p: 1)), "event 0", "int"),
    bad("an event of one argument", lambda: decays(event=tx.Event(lambda t: t)), "Event", "(t, x, u, params)"),
    bad("an event that gives nothing", lambda: decays(event=tx.Event(lambda t, x, u, p: None)), "event 0", "None"),
    # solutions
    bad("a state between steps that were not kept", lambda: decays().evaluate(0.5), "dense", "dense=True"),
    bad("a time outside", lambda: solution().evaluate(2.0), "evaluate", "[0, 1]", "2"),
    bad("a time of NaN", lambda: solution().evaluate(np.nan), "evaluate", "nan"),
    bad("a time of text", lambda: solution().evaluate("0.5"), "evaluate", "'0.5'"),
    bad("times in a matrix", lambda: solution().evaluate(np.zeros((2, 2))), "evaluate", "(2, 2)"),
    bad("an unknown count", lambda: solution().stats["evaluations"], "'evaluations'", "rhs_evaluations"),
    # what ends early
    bad("a blow-up", lambda: tx.integrate(tx.compile(tx.System({s: s**3})), {"s": 1.0}, t1=2.0, dt=0.5), "'s'", "t = "),
    # diffrax
    bad("a term of a system that is not compiled", lambda: tx.diffrax.lie_term(decay().system), "System", "tx.compile"),
    bad("an ambient term of text", lambda: tx.diffrax.ambient_term("decay"), "str", "tx.compile"),
    bad("a Lie solver of text", lambda: tx.diffrax.LieSolver("tsit5", decay()), "LieSolver", "str"),
    bad("a Lie solver without a system", lambda: tx.diffrax.LieSolver(diffrax.Tsit5(), None), "LieSolver", "NoneType"),
    bad(
        "a Lie solver of a multistep method",
        lambda: tx.diffrax.LieSolver(diffrax.SemiImplicitEuler(), decay()),
        "LieSolver",
        "SemiImplicitEuler",
    ),
    bad("a controller of text", lambda: tx.diffrax.controller("tight"), "rtol", "'tight'"),
    bad("a controller with a negative tolerance", lambda: tx.diffrax.controller(-1.0), "rtol", "-1"),
    bad(
        "arguments of a term that are no pair",
        lambda: tx.diffrax.ambient_term(cart()).vector_field(
            0.0, {"position": jnp.ones(()), "velocity": jnp.ones(())}, U
        ),
        "args",
        "(u, params)",
    ),
    # under jit
    bad("a traced span with dt", lambda: jax.jit(lambda t1: decays(t1=t1).xs)(1.0), "t1", "traced", "steps"),
    bad("a traced dt", lambda: jax.jit(lambda dt: decays(dt=dt).xs)(0.1), "dt", "traced", "steps"),
    # a simulator
    bad("a simulator of text", lambda: tx.simulator("decay", DECAY, t1=1.0, dt=0.5), "str", "tx.compile"),
    bad(
        "an option no simulator has", lambda: tx.simulator(decay(), DECAY, t1=1.0, dt=0.5, progress=True), "'progress'"
    ),
    bad("a simulator without steps", lambda: tx.simulator(decay(), DECAY, t1=1.0), "dt", "steps"),
    bad("a simulator's start by another name", lambda: made()({"y": 1.0}), "'y'", "x0", "built with"),
    bad("a simulator's start of text", lambda: made()(dict.fromkeys(DECAY, "one")), "x0", "'one'"),
    bad("a simulator's start of NaN", lambda: made()(dict.fromkeys(DECAY, np.nan)), "x0", "finite"),
    bad("a simulator's start as a list", lambda: made()([1.0]), "x0", "dict"),
]
