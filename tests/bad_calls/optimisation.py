"""Bad uses of `tx.trajectory`: the problem and its arguments, linearising, discretising."""

import functools

import numpy as np
from shared import AT_REST, INERTIA, TORQUE, U, X, body, cart, decay
from table import bad

import twistax as tx

position, velocity, force = tx.State("position"), tx.State("velocity"), tx.Control("force")
effort = tx.Minimize(running=force**2)


def problem(dynamics=None, objective=effort, **options):
    return tx.trajectory.Problem(
        dynamics or cart(), objective, **({"nodes": 5, "final_time": 1.0, "initial": X} | options)
    )


@functools.cache
def easy() -> tx.trajectory.Problem:
    return problem(final={"position": 0.1})


def discretized(**options):
    return tx.trajectory.discretize(**({"dynamics": cart(), "t": 0.0, "x": X, "u": U, "h": 0.1} | options))


@functools.cache
def two_phases():
    phase = functools.partial(tx.trajectory.Phase, cart(), effort, nodes=3, final_time=1.0)
    return tx.trajectory.Problem([phase(initial=X, name="a"), phase(name="b")])


price = tx.Parameter("price", value=1.0)


def weighted(**options):
    return problem(objective=tx.Minimize(running=price * force**2), **options)


peak, work = tx.trajectory.Maximum(force), tx.trajectory.Integral(force**2)

ROWS = [
    bad("an integral of text", lambda: tx.trajectory.Integral("fuel"), "Integral", "'fuel'"),
    bad("an integral of a condition", lambda: tx.trajectory.Integral(force <= 1.0), "Integral", "force <= 1"),
    bad("where an expression began", lambda: tx.trajectory.Initial(2.0 * position), "Initial", "state", "position"),
    bad("a peak to be made large", lambda: problem(objective=tx.Maximize(peak)), "Maximum(force)", "small"),
    bad("a peak that equals", lambda: problem(final=[peak == 1.0]), "Maximum(force)", "<="),
    bad("a peak at a node", lambda: problem(at={2: peak <= 1.0}), "Maximum(force)", "whole path"),
    bad(
        "an integral at the start",
        lambda: problem(initial=[X, work <= 1.0]),
        "Integral(force ** 2.)",
        "not defined at the start",
    ),
    bad("an integral as a rate", lambda: tx.System(rates={position: work}), "Integral(force ** 2.)", "final="),
    bad("limits at a solve of what is not free", lambda: easy().solve(free={"mass": (1.0, 2.0)}), "'mass'", "free"),
    bad("limits at a solve that are a number", lambda: easy().solve(free=3.0), "free", "3.0"),
    bad("parameters at a solve that are a number", lambda: easy().solve(params=3.0), "params", "3.0"),
    bad("a Hessian by name", lambda: problem(hessian="GaussNewton"), "hessian", "'GaussNewton'", "GaussNewton()"),
    bad("a Hessian that is a class", lambda: problem(hessian=tx.trajectory.GaussNewton), "hessian", "GaussNewton()"),
    bad(
        "Gauss-Newton of a product",
        lambda: problem(objective=tx.Minimize(running=force * position), hessian=tx.trajectory.GaussNewton()),
        *("GaussNewton", "sum of squares", "force * position", "fix:"),
    ),
    bad(
        "updates for a solver of others",
        lambda: problem(hessian=tx.trajectory.QuasiNewton()).solve(solver=tx.trajectory.IPOPT()),
        *("QuasiNewton", "IPOPT", "fix:"),
    ),
    bad("values by node of a name", lambda: problem(by_node=["weight"]), "by_node", "list of parameters", "'weight'"),
    bad("values by node of one parameter", lambda: weighted(by_node=price), "by_node", "list of parameters"),
    bad("values by node that nothing reads", lambda: problem(by_node=[price]), "by_node", "'price'", "does not read"),
    bad(
        "values by node in a condition",
        lambda: weighted(by_node=[price], final=[position == price]),
        *("by_node", "'price'", "constraint", "fix:"),
    ),
    bad(
        "values for other nodes",
        lambda: weighted(by_node=[price]).solve(params={price: [1.0, 2.0]}),
        *("params['price']", "(5,)", "(2,)"),
    ),
    bad("values by node that are text", lambda: weighted(by_node=[price]).solve(params={price: "a"}), "price", "'a'"),
    bad("a soft number", lambda: tx.Soft(3.0, l1=1.0), "Soft", "constraint", "float"),
    bad("a soft strict constraint", lambda: tx.Soft(position < 1.0, l1=1.0), "Soft", "position < 1", "strict", "<= 1"),
    bad("a price that is a state", lambda: problem(_priced()), "the weight of position <= 1.", "'h'"),
    bad("a soft constraint without a price", lambda: tx.Soft(position <= 1.0), "Soft", "l1=", "l2="),
    bad("a price below zero", lambda: tx.Soft(position <= 1.0, l1=-1.0), "Soft", "l1", "0 or more"),
    bad("a price of another shape", lambda: tx.Soft(position <= 1.0, l2=[1.0, 2.0]), "Soft", "l2", "(2,)"),
    bad("ends of phases by state", lambda: two_phases().solve(initial={position: 0.0}), "'position'", "'a', 'b'"),
    bad("ends of phases that are a number", lambda: two_phases().solve(final=3.0), "final", "3.0", "phases"),
    bad("a time of no phase", lambda: two_phases().solve(final_time={"c": 1.0}), "'c'", "'a', 'b'"),
    bad("parameters of phases that are a number", lambda: two_phases().solve(params=3.0), "params", "3.0"),
    bad("derivatives of phases", lambda: tx.trajectory.solution(two_phases()), "solution", "Problem of one phase"),
    bad("derivatives by text", lambda: tx.trajectory.solution(easy())(initial={"position": "a"}), "position", "'a'"),
    bad(
        "a problem of a system that is not compiled", lambda: problem(cart().system), "Problem", "System", "tx.compile"
    ),
    bad("a problem of a function", lambda: problem(lambda t, x: x), "Problem", "function", "tx.compile"),
    bad("an objective that is an expression", lambda: problem(objective=position), "Problem", "State", "tx.Minimize"),
    bad("an objective by name", lambda: problem(objective="fuel"), "Problem", "str", "tx.Minimize"),
    bad("no objective", lambda: tx.Minimize(), "Minimize", "running"),
    bad("an objective of a vector", lambda: tx.Minimize(tx.State("v", 3)), "Minimize", "(3,)"),
    bad("an objective of text", lambda: tx.Minimize("fuel"), "Minimize", "'fuel'"),
    bad("an objective of a condition", lambda: tx.Maximize(position <= 1.0), "Maximize", "position <= 1"),
    bad("a final cost of a control", lambda: problem(objective=tx.Minimize(force)), "'force'", "final"),
    bad("a cost of a state it has not", lambda: problem(objective=tx.Minimize(tx.State("h"))), "'h'"),
    bad("a condition of a state it has not", lambda: problem(final=[tx.State("h") == 1.0]), "'h'"),
    bad("a condition of NaN", lambda: problem(final=[position <= np.nan]), "final", "position", "nan"),
    bad("a cost of NaN", lambda: problem(objective=tx.Minimize(np.nan * position)), "objective", "nan"),
    bad(
        "a cost of a held control's rate",
        lambda: problem(objective=tx.Minimize(running=tx.trajectory.Rate(force))),
        "rate of force",
        "Linear",
    ),
    bad("a cost of a parameter without a value", lambda: problem(objective=tx.Minimize(tx.Parameter("c"))), "'c'"),
    bad("one node", lambda: problem(nodes=1), "nodes", "1"),
    bad("half a node", lambda: problem(nodes=2.5), "nodes", "2.5"),
    bad("nodes of text", lambda: problem(nodes="25"), "nodes", "'25'"),
    bad("no substeps", lambda: problem(substeps=0), "substeps", "0"),
    bad("a final time of zero", lambda: problem(final_time=0.0), "final_time", "0.0"),
    bad("a negative final time", lambda: problem(final_time=-1.0), "final_time", "-1.0"),
    bad("a final time of text", lambda: problem(final_time="free"), "final_time", "'free'"),
    bad("a final time of None", lambda: problem(final_time=None), "final_time", "limits", "None"),
    bad("limits of time that cross", lambda: problem(final_time=(2.0, 1.0)), "final_time", "(2.0, 1.0)"),
    bad("three limits of time", lambda: problem(final_time=(1.0, 2.0, 3.0)), "final_time", "(1.0, 2.0, 3.0)"),
    bad("a final time without end", lambda: problem(final_time=(1.0, np.inf)), "final_time", "inf"),
    bad("a final time of NaN", lambda: problem(final_time=np.nan), "final_time", "nan"),
    bad(
        "a guess of time outside",
        lambda: problem(final_time=(1.0, 2.0), final_time_guess=3.0),
        "final_time_guess",
        "3.0",
    ),
    bad(
        "a guess of time of text",
        lambda: problem(final_time=(1.0, 2.0), final_time_guess="1"),
        "final_time_guess",
        "'1'",
    ),
    bad("a start as a list", lambda: problem(initial=[0.0, 1.0]), "initial", "list"),
    bad("a start of a state it has not", lambda: problem(initial={"velocty": 1.0}), "'velocty'", "velocity"),
    bad("a start of another shape", lambda: problem(initial={"velocity": [1.0, 2.0]}), "initial", "(2,)"),
    bad("a start of text", lambda: problem(initial={"velocity": "1"}), "initial", "1"),
    bad("an infinite start", lambda: problem(initial={"velocity": np.inf}), "initial", "inf"),
    bad(
        "a start that is no pose",
        lambda: problem(
            body(), tx.Minimize(tx.State("V", 6)[0]), params=INERTIA, initial=AT_REST | {"g": np.zeros((4, 4))}
        ),
        "initial",
        "'g'",
    ),
    bad(
        "an end that breaks a bound",
        lambda: problem(_bounded(), final={"h": -1.0}, initial={}, objective=tx.Minimize(tx.State("h", min=0.0))),
        "final",
        "h",
        "-1",
    ),
    bad("an end of a number", lambda: problem(final=3.0), "final", "float"),
    bad("an end of an expression", lambda: problem(final=[position]), "final", "State"),
    bad("an end that holds a control", lambda: problem(final=[force <= 1.0]), "final", "'force'"),
    bad("an end of another state", lambda: problem(final={"height": 0.0}), "final", "'height'"),
    bad("a guess of a name it has not", lambda: problem(guess={"velocty": 1.0}), "guess", "'velocty'"),
    bad("a guess of another length", lambda: problem(guess={"velocity": [1.0, 2.0]}), "guess['velocity']", "(2,)"),
    bad("a guess of NaN", lambda: problem(guess={"velocity": np.nan}), "guess['velocity']", "nan"),
    bad("a guess of text", lambda: problem(guess={"velocity": "fast"}), "guess['velocity']", "'fast'"),
    bad("guesses as a list", lambda: problem(guess=[1.0]), "guess", "list"),
    bad("a parameter it has not", lambda: problem(params={"mas": 1.0}), "'mas'", "'mass'"),
    bad("a parameter of NaN", lambda: problem(params={"mass": np.nan}), "params['mass']", "nan"),
    bad(
        "a parameter that is missing", lambda: problem(body(), tx.Minimize(tx.State("V", 6)[0]), initial=AT_REST), "'J'"
    ),
    bad("a method by name", lambda: problem(method="RK4"), "method", "'RK4'", "tx.RKMK"),
    bad("a tableau as a method", lambda: problem(method=tx.tableaus.RK4), "method", "RK4", "tx.RKMK"),
    bad("an implicit method", lambda: problem(method=tx.ImplicitRKMK(tx.tableaus.RADAU_IIA3)), "method", "Radau"),
    bad("no guesses", lambda: easy().solve(guesses=0), "guesses", "0"),
    bad("guesses of text", lambda: easy().solve(guesses="many"), "guesses", "'many'"),
    bad("half an iteration", lambda: easy().solve(max_iterations=0.5), "max_iterations", "0.5"),
    bad("a tolerance of zero", lambda: easy().solve(tolerance=0.0), "tolerance", "0.0"),
    bad("a tolerance of everything", lambda: easy().solve(tolerance=1e3), "tolerance", "1000"),
    bad("a tolerance of text", lambda: easy().solve(tolerance="tight"), "tolerance", "'tight'"),
    bad("a seed of text", lambda: easy().solve(seed="one"), "seed", "'one'"),
    bad("a callback that is none", lambda: easy().solve(callback=3), "callback", "3"),
    bad("a guess at solving of a name it has not", lambda: easy().solve({"velocty": 1.0}), "guess", "'velocty'"),
    # derivatives
    bad(
        "a linearisation of a system", lambda: tx.trajectory.linearize(cart().system, 0.0, X, U), "linearize", "System"
    ),
    bad("a linearisation without a control", lambda: tx.trajectory.linearize(cart(), 0.0, X), "'force'", "missing"),
    bad(
        "a linearisation of another shape",
        lambda: tx.trajectory.linearize(decay(), 0.0, {"x": 1.0, "v": 1.0}),
        "x['v']",
        "()",
    ),
    bad("a discretisation of text", lambda: discretized(dynamics="cart"), "discretize", "str"),
    bad("an interval of text", lambda: discretized(h="0.1"), "h", "'0.1'"),
    bad("an interval of NaN", lambda: discretized(h=np.nan), "h", "nan"),
    bad("intervals", lambda: discretized(h=[0.1, 0.2]), "h", "[0.1, 0.2]"),
    bad("half a substep", lambda: discretized(substeps=1.5), "substeps", "1.5"),
    bad("a discretisation by name", lambda: discretized(method="RK4"), "method", "'RK4'", "tx.RKMK"),
    bad(
        "a discretisation in ambient numbers",
        lambda: discretized(
            dynamics=body(), x=AT_REST, u=TORQUE, params=INERTIA, method=tx.RKMK(tx.tableaus.RK4, tx.charts.Ambient())
        ),
        "derivatives",
        "tx.charts.Exponential",
    ),
    bad(
        "a discretisation by an implicit method",
        lambda: discretized(method=tx.ImplicitRKMK(tx.tableaus.RADAU_IIA3)),
        "method",
        "Radau",
    ),
]


@functools.cache
def _bounded() -> tx.Dynamics:
    h = tx.State("h", min=0.0)
    return tx.compile(tx.System({h: -h}))


def _priced() -> tx.Dynamics:
    row = tx.Soft(position <= 1.0, l1=tx.State("h"))
    return tx.compile(tx.System(rates={position: velocity, velocity: force}, constraints=[row]))
