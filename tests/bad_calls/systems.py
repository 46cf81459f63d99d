"""Bad uses of systems: building, compiling, calling, lowering."""

import jax
import numpy as np
from shared import AT_REST, DECAY, INERTIA, TORQUE, U, X, body, cart, decay
from table import bad

import twistax as tx

s, v, u = tx.State("s"), tx.State("v", shape=(3,)), tx.Control("u")
p = tx.Parameter("p", value=1.0)
g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
W = tx.State("W", shape=(6,))

ROWS = [
    # systems
    bad("no states", lambda: tx.System({}), "System", "{}"),
    bad("rates as a list", lambda: tx.System([(s, -s)]), "System", "list"),
    bad("rates as an expression", lambda: tx.System(-s), "System", "Neg"),
    bad("a key that is a control", lambda: tx.System({u: s}), "rates", "u"),
    bad("a key that is a number", lambda: tx.System({3: s}), "rates", "3"),
    bad("a name that no state has", lambda: tx.System({"velocty": s, "s": 1.0}), "'velocty'", "s"),
    bad("a misspelt key", lambda: tx.System({"ss": -s}), "'ss'", "'s'"),
    bad("a state without a rate", lambda: tx.System({s: -v[0]}), "'v'", "rate"),
    bad("a rate of another shape", lambda: tx.System({s: v, v: -v}), "'s'", "(3,)"),
    bad("a rate of a pose that is a matrix", lambda: tx.System({g: g}), "'g'", "(6,)", "(4, 4)"),
    bad("a rate of text", lambda: tx.System({s: "-s"}), "rates['s']", "'-s'"),
    bad("a rate of None", lambda: tx.System({s: None}), "rates['s']", "None"),
    bad("a rate that is a function", lambda: tx.System({s: lambda t: t}), "rates['s']", "function"),
    bad("a rate that is a condition", lambda: tx.System({s: s <= 0.0}), "'s'", "s <= 0", "tx.Where"),
    bad("a rate of NaN", lambda: tx.System({s: np.nan}), "'s'", "nan"),
    bad("an infinite rate", lambda: tx.System({s: np.inf}), "'s'", "inf"),
    bad("a sum with NaN", lambda: tx.System({s: -s + float("nan")}), "'s'", "nan"),
    bad("an entry of NaN", lambda: tx.System({v: tx.Concat(s, 0.0, np.nan), s: -s}), "'v'", "nan"),
    bad("an output of NaN", lambda: tx.System({s: -s}, {"y": s * np.nan}), "'y'", "nan"),
    bad("two states of one name", lambda: tx.System({s: 1.0, tx.State("s"): 2.0}), "'s'", "two"),
    bad("slopes as a list", lambda: tx.System({s: -s}, slopes=[(s, -1.0)]), "slopes", "list"),
    bad("slopes of no state", lambda: tx.System({s: -s}, slopes={u: [(s, -1.0)]}), "slopes", "'u'", "s"),
    bad("slopes that are no pairs", lambda: tx.System({s: -s}, slopes={s: -1.0}), "slopes['s']", "pairs", "-1.0"),
    bad("a slope of another shape", lambda: tx.System({v: -v}, slopes={v: [(v, v)]}), "slopes['v']", "(3, 3)", "(3,)"),
    bad("a slope by a matrix", lambda: tx.System({v: -v}, slopes={v: [(np.eye(3), v)]}), "slopes['v']", "(3, 3)"),
    bad("a slope of what is not there", lambda: tx.System({v: -v}, slopes={v: [(u[None], v)]}), "slopes['v']", "'u'"),
    bad("a rate given twice", lambda: tx.System({s: -s, "s": s}), "'s'", "twice"),
    bad("a state and a control of one name", lambda: tx.System({s: tx.Control("s")}), "'s'", "State", "Control"),
    bad("two parameters of one name", lambda: tx.System({s: p * tx.Parameter("p", value=2.0)}), "'p'", "value"),
    bad("two shapes of one name", lambda: tx.System({s: p + tx.Parameter("p", 3)[0]}), "'p'", "(3,)"),
    bad("a control that is not declared", lambda: tx.System({s: u}, controls=[]), "'u'", "controls"),
    bad("a declared control that is none", lambda: tx.System({s: u}, controls=[u, s]), "controls=", "s"),
    bad("a control declared by name", lambda: tx.System({s: u}, controls=["u"]), "controls=", "'u'"),
    bad("parameters as a number", lambda: tx.System({s: p * s}, parameters=3), "parameters", "3"),
    bad("outputs as a list", lambda: tx.System({s: -s}, [s]), "outputs", "list"),
    bad("an output of text", lambda: tx.System({s: -s}, {"y": "s"}), "outputs['y']", "'s'"),
    bad("an output whose name is a number", lambda: tx.System({s: -s}, {1: s}), "outputs", "1"),
    bad("constraints of expressions", lambda: tx.System({s: -s}, constraints=[s]), "constraint", "State"),
    bad("a constraint that is true", lambda: tx.System({s: -s}, constraints=[True]), "constraint", "bool"),
    bad("constraints as a number", lambda: tx.System({s: -s}, constraints=3), "constraint", "3"),
    bad("a shape inside that does not fit", lambda: tx.System({s: tx.linalg.Norm(v + V), v: -v, V: V}), "Add", "(6,)"),
    bad("two orders that meet", lambda: _two_orders(), "LINEAR_FIRST", "ANGULAR_FIRST", "Reorder"),
    # compile
    bad("a compilation of an expression", lambda: tx.compile(-s), "compile", "Neg", "tx.lower"),
    bad("a compilation of a dict", lambda: tx.compile({s: -s}), "compile", "dict"),
    bad("a compilation of a function", lambda: tx.compile(lambda x: -x), "compile", "function"),
    bad("a compilation of what is compiled", lambda: tx.compile(cart()), "compile", "Dynamics"),
    bad("an output it has not", lambda: tx.compile(cart().system, outputs=["powr"]), "'powr'", "'power'"),
    bad("outputs as a number", lambda: tx.compile(cart().system, outputs=3), "outputs", "3"),
    bad("a parameter it has not", lambda: tx.compile(cart().system, bake={"mas": 1.0}), "'mas'", "'mass'"),
    bad("baked values as a list", lambda: tx.compile(cart().system, bake=["mass"]), "bake", "list"),
    bad("a baked None", lambda: tx.compile(cart().system, bake={"mass": None}), "bake['mass']", "None"),
    bad("a baked text", lambda: tx.compile(cart().system, bake={"mass": "2"}), "'mass'", "2"),
    bad("a baked vector for a matrix", lambda: tx.compile(body().system, bake={"J": [1.0, 2.0, 3.0]}), "'J'", "(3,)"),
    bad("a baked complex", lambda: tx.compile(cart().system, bake={"mass": 1j}), "'mass'", "complex"),
    bad(
        "a baked tracer",
        lambda: jax.jit(lambda m: tx.compile(cart().system, bake={"mass": m})(0.0, X, U))(1.0),
        "bake['mass']",
        "traced",
    ),
    bad("a backend by name", lambda: tx.compile(cart().system, backend="xla"), "backend", "'xla'"),
    bad("a backend that is a class", lambda: tx.compile(cart().system, backend=tx.XLA), "backend", "XLA"),
    bad("scalars by a negative number", lambda: tx.XLA(least=-1), "XLA", "least", "-1"),
    bad("scalars by text", lambda: tx.XLA(largest="many"), "XLA", "largest", "'many'"),
    bad("threads by text", lambda: tx.Native(threads="all"), "Native", "threads", "'all'"),
    bad("no threads", lambda: tx.Native(threads=0), "Native", "threads", "0"),
    bad("scalars that are none", lambda: tx.Native(scalars=3), "Native", "scalars", "3"),
    # calls
    bad("a state that is missing", lambda: cart()(0.0, {"position": 0.0}, U), "'velocity'", "missing"),
    bad("a misspelt state", lambda: cart()(0.0, X | {"velocty": 1.0}, U), "'velocty'", "'velocity'"),
    bad("a state by its leaf", lambda: decay()(0.0, {tx.State("x"): 1.0}), "unknown key x", "by name here: {'x': ...}"),
    bad("states as a list", lambda: cart()(0.0, [0.0, 1.0], U), "x must be a dict", "list"),
    bad("states as an array", lambda: cart()(0.0, np.zeros(2), U), "x must be a dict", "ndarray"),
    bad("states as None", lambda: cart()(0.0, None, U), "'position'", "none"),
    bad("a state of another shape", lambda: decay()(0.0, DECAY | {"v": np.ones(2)}), "x['v']", "(3,)", "(2,)"),
    bad("a column for a vector", lambda: decay()(0.0, DECAY | {"v": np.ones((3, 1))}), "x['v']", "(3, 1)"),
    bad("a batch", lambda: decay()(0.0, {"x": np.ones(5), "v": np.ones((5, 3))}), "x['x']", "(5,)", "jax.vmap"),
    bad("a scalar for a vector", lambda: decay()(0.0, DECAY | {"v": 1.0}), "x['v']", "()"),
    bad("a state of text", lambda: cart()(0.0, X | {"velocity": "1"}, U), "x['velocity']", "'1'"),
    bad("a state of None", lambda: cart()(0.0, X | {"velocity": None}, U), "x['velocity']", "None"),
    bad("a complex state", lambda: cart()(0.0, X | {"velocity": 1j}, U), "x['velocity']", "complex"),
    bad(
        "a complex state of JAX",
        lambda: cart()(0.0, X | {"velocity": jax.numpy.asarray(1j)}, U),
        "x['velocity']",
        "complex",
    ),
    bad("a ragged state", lambda: decay()(0.0, DECAY | {"v": [1.0, [2.0], 3.0]}), "x['v']", "[1.0, [2.0], 3.0]"),
    bad(
        "a masked state",
        lambda: decay()(0.0, DECAY | {"v": np.ma.masked_equal([1.0, 2.0, 3.0], 2.0)}),
        "x['v']",
        "masked",
    ),
    bad(
        "a state that is a function", lambda: cart()(0.0, X | {"velocity": lambda t: t}, U), "x['velocity']", "function"
    ),
    bad("a state that is an expression", lambda: decay()(0.0, DECAY | {"x": s}), "x['x']", "State"),
    bad("a control that is missing", lambda: cart()(0.0, X), "'force'", "missing"),
    bad("a misspelt control", lambda: cart()(0.0, X, {"forc": 1.0}), "'forc'", "'force'"),
    bad("controls as a number", lambda: cart()(0.0, X, 1.0), "u must be a dict", "float"),
    bad("a parameter without a value", lambda: body()(0.0, AT_REST, TORQUE), "'J'", "no value"),
    bad("a misspelt parameter", lambda: cart()(0.0, X, U, {"Mass": 1.0}), "'Mass'", "'mass'"),
    bad("a parameter of another shape", lambda: body()(0.0, AT_REST, TORQUE, {"J": np.ones(3)}), "params['J']", "(3,)"),
    bad("parameters as a list", lambda: cart()(0.0, X, U, [1.0]), "params must be a dict", "list"),
    bad("a time of text", lambda: cart()("0", X, U), "t ", "'0'"),
    bad("a time of None", lambda: cart()(None, X, U), "t ", "None"),
    bad("times", lambda: cart()(np.zeros(3), X, U), "t ", "(3,)"),
    bad("states in the place of time", lambda: cart()(X, U), "t ", "dict"),
    bad(
        "too large for single precision",
        lambda: decay()(0.0, {"x": 1e300, "v": np.ones(3, np.float32)}),
        "x['x']",
        "1e+300",
        "float32",
    ),
    bad("an unknown family of derivatives", lambda: cart().jacobian(0.0, X, U, wrt="y"), "wrt", "'y'"),
    bad("a derivative twice", lambda: cart().jacobian(0.0, X, U, wrt=("x", "x")), "wrt", "'x'"),
    bad("a derivative by a number", lambda: cart().jacobian(0.0, X, U, wrt=3), "wrt", "3"),
    bad("a tangent of another length", lambda: decay().retract(DECAY, np.zeros(3)), "(4,)", "(3,)"),
    bad("a tangent of text", lambda: decay().retract(DECAY, "d"), "d", "'d'"),
    bad("a difference without a state", lambda: decay().difference(DECAY, {"x": 1.0}), "'v'", "missing"),
    bad("an explanation of what is not there", lambda: cart().explain("velocty"), "'velocty'", "velocity"),
    bad("an explanation of an entry it has not", lambda: decay().explain("v[3]"), "v[3]", "v[0] to v[2]"),
    bad("an explanation of a number", lambda: cart().explain(3), "explain", "3"),
    bad("a Hessian without weights", lambda: cart().hessian(0.0, X, U, None, None), "weights", "NoneType"),
    bad("a Hessian weighed by text", lambda: cart().hessian(0.0, X, U, None, "w"), "weights", "str"),
    bad("weights of another shape", lambda: cart().hessian(0.0, X, U, None, {"position": [1.0]}), "weights", "(1,)"),
    bad(
        "a weight of text",
        lambda: cart().hessian(0.0, X, U, None, {"position": "much"}),
        "weights['position']",
        "'much'",
    ),
    bad(
        "weights of what it has not", lambda: cart().hessian(0.0, X, U, None, {"positn": 1.0}), "'positn'", "'position'"
    ),
    bad("text made fast", lambda: tx.fast("f"), "fast", "str"),
    bad("a system made fast", lambda: tx.fast(cart().system), "fast", "System"),
    bad("a sweep of text", lambda: tx.sweep("f", {}), "sweep", "'f'"),
    # lower
    bad("nothing to lower", lambda: tx.lower({}), "lower", "{}"),
    bad("a lowering of text", lambda: tx.lower("s"), "'s'", "expression"),
    bad("a lowering of a function", lambda: tx.lower(lambda s: s), "function", "expression"),
    bad("a lowering of a system", lambda: tx.lower(cart().system), "System", "tx.compile"),
    bad("two leaves of one name", lambda: tx.lower(s + tx.State("s", 3)), "'s'", "(3,)"),
    bad("a lowered call without a state", lambda: tx.lower(s * v)(0.0, {"s": 1.0}), "'v'", "missing"),
    bad("a lowered call without states", lambda: tx.lower(s * v)(0.0), "'s'", "missing"),
    bad("a lowered call with a control too much", lambda: tx.lower(s * 1.0)(0.0, {"s": 1.0}, {"v": 1.0}), "'v'"),
    bad("a lowered call with a wrong shape", lambda: tx.lower(v)(0.0, {"v": np.ones(2)}), "x['v']", "(2,)"),
    bad("a lowered call at several times", lambda: tx.lower(s * 1.0)(np.zeros(3), {"s": 1.0}), "t", "(3,)"),
    bad("a lowered call at no time", lambda: tx.lower(s * 1.0)(None, {"s": 1.0}), "t", "None"),
    bad(
        "a lowered call with a complex state", lambda: tx.lower(v)(0.0, {"v": 1j * np.ones(3)}), "x['v']", "complex128"
    ),
    bad("a lowered call with an expression", lambda: tx.lower(v)(0.0, {"v": v}), "x['v']", "State", "expression"),
    bad("a gradient of no function", lambda: tx.tangent_grad(3.0), "tangent_grad", "3.0"),
    bad("a gradient on no group", lambda: tx.tangent_grad(lambda g: g, group="SE3"), "tangent_grad", "'SE3'"),
    bad("an unknown inertia", lambda: body()(0.0, AT_REST, TORQUE, INERTIA | {"m": 1.0}), "'m'", "'J'"),
]


def _two_orders() -> tx.System:
    a, b = tx.State("a", shape=(6,)), tx.State("b", shape=(6,))
    left = tx.lie.Adjoint(a, b)
    return tx.System({a: left, b: tx.lie.Adjoint(a, b, order=tx.ANGULAR_FIRST)})
