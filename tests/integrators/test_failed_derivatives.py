"""The derivative of an integration that failed is NaN, by every method and in every mode; others keep theirs."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from registered import concrete_classes
from twistax.integrators import Method

RADAU = tx.ImplicitRKMK(tx.tableaus.RADAU_IIA5)


#: A method of each class that has some, by its tableaus; what else makes one.
METHODS: dict[str, list[tuple[str, Method]]] = {"RKMK": [], "ImplicitRKMK": [], "CommutatorFree": []}
for _name, _tableau in vars(tx.tableaus).items():
    if isinstance(_tableau, tx.tableaus.ButcherTableau):
        METHODS["RKMK"].append((_name, tx.RKMK(_tableau)))
    elif isinstance(_tableau, tx.tableaus.CollocationTableau):
        METHODS["ImplicitRKMK"].append((_name, tx.ImplicitRKMK(_tableau)))
    elif isinstance(_tableau, tx.tableaus.CommutatorFreeTableau):
        METHODS["CommutatorFree"].append((_name, tx.CommutatorFree(_tableau)))
METHODS["RKMK"] += [(repr(chart), tx.RKMK(tx.tableaus.RK4, chart)) for chart in (tx.charts.Ambient(),)]
METHODS["Magnus"] = [(f"Magnus {order}", tx.Magnus(order)) for order in (4, 6)]
METHODS["Splitting"] = [("KAHAN_LI8", tx.Splitting(tx.compositions.KAHAN_LI8, tx.FreeParticle("x", "v")))]

#: One of each class and chart, with and without an error estimate; the others, which differ in coefficients, are slow.
FIRST = {"RK4", "BOGACKI_SHAMPINE3", "Ambient()", "RADAU_IIA5", "CF4", "Magnus 4", "KAHAN_LI8"}
CASES = [(kind, name, method) for kind, each in METHODS.items() for name, method in each]


def test_every_method_is_here() -> None:
    # The fallback for systems with corrections wraps another one, and is tried below.
    assert {cls.__name__ for cls in concrete_classes(Method)} - {"Projected"} == set(METHODS)
    assert all(METHODS.values())
    assert {name for _, name, _ in CASES} >= FIRST


@functools.cache
def ending() -> tx.Dynamics:
    """An oscillator whose force is no number from a time on, k."""
    x, v, k, t = tx.State("x"), tx.State("v"), tx.Parameter("k", value=0.5), tx.Time()
    return tx.compile(tx.System(rates={x: v, v: tx.Sqrt(k - t) - x}))


#: How steps are taken; the second where a method estimates errors.
HOW: dict[str, dict[str, Any]] = {"fixed": {"steps": 20}, "tolerances": {"rtol": 1e-5, "atol": 1e-5}}


def end(method: Method | None, how: dict[str, Any], x: Any, k: Any) -> jax.Array:
    found = tx.integrate(ending(), {"x": x, "v": 0.3 + 0.0 * x}, t1=1.0, params={"k": k}, method=method, **how)
    return found.xs["x"][-1] + found.xs["v"][-1]


def derivatives(function: Callable[..., jax.Array]) -> Callable[..., Any]:
    """Forward and in reverse, by the start and by the parameter."""
    return lambda *inputs: (jax.jacfwd(function, (0, 1))(*inputs), jax.grad(function, (0, 1))(*inputs))


def chosen(cases: list[Any]) -> list[Any]:
    return [
        pytest.param(method, how, id=f"{kind}-{name}-{how}")
        for kind, name, method in cases
        for how in HOW
        if how == "fixed" or estimates(method)
    ]


def estimates(method: Method) -> bool:
    try:
        return bool(method.error_order)
    except tx.ModelError:
        return False


def check(method: Method, how: str) -> None:
    """Of a batch the member whose force ends before t1 has NaN, the other its derivative."""
    of_x = functools.partial(end, method, HOW[how])
    xs, ks = jnp.array([0.7, 0.7, 0.2]), jnp.array([3.0, 0.5, -1.0])
    values, slopes = jax.jit(jax.vmap(lambda x, k: (of_x(x, k), derivatives(of_x)(x, k))))(xs, ks)
    assert np.isfinite(values).tolist() == [True, False, False]
    for slope in jax.tree.leaves(slopes):
        assert np.isfinite(slope).tolist() == [True, False, False], (slope, slopes)
    forward, reverse = slopes
    np.testing.assert_allclose(forward, reverse, rtol=1e-6)
    if how == "tolerances":
        # Neighbours choose other steps, so that differences jump by the tolerance: the exact derivative instead.
        np.testing.assert_allclose(forward[0][0], np.cos(1.0) - np.sin(1.0), rtol=0.0, atol=1e-3)
        return
    h = 1e-4
    beside = jax.jit(jax.vmap(of_x))(jnp.array([0.7 + h, 0.7 - h]), jnp.full(2, 3.0))
    np.testing.assert_allclose(forward[0][0], (beside[0] - beside[1]) / (2 * h), rtol=2e-4)


@pytest.mark.parametrize(("method", "how"), chosen([case for case in CASES if case[1] in FIRST]))
def test_a_failed_member_alone_has_nan(method: Method, how: str) -> None:
    check(method, how)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "how"), chosen([case for case in CASES if case[1] not in FIRST]))
def test_a_failed_member_alone_has_nan_by_others(method: Method, how: str) -> None:
    check(method, how)


@pytest.mark.parametrize("how", HOW)
def test_a_first_step_that_fails(how: str) -> None:
    """No step reads the parameter, so that nothing but the failure itself says that it counts."""
    of = functools.partial(end, None, HOW[how])
    assert np.isnan(jax.tree.leaves(jax.jit(derivatives(of))(0.7, -1.0))).all()


def test_a_system_with_corrections() -> None:
    q = tx.State("q", shape=(2,))
    k, t = tx.Parameter("k", value=0.5), tx.Time()
    turn = tx.Sqrt(k - t) * tx.Concat(-q[1], q[0])
    system = tx.compile(tx.System(rates={q: turn}, corrections={q: 0.5 * q * (1.0 / tx.linalg.Dot(q, q) - 1.0)}))

    def end(k: jax.Array) -> jax.Array:
        return tx.integrate(system, {"q": jnp.array([1.0, 0.0])}, t1=1.0, params={"k": k}, steps=10).xs["q"][-1, 0]

    slopes = jax.jit(lambda k: (jax.jacfwd(end)(k), jax.grad(end)(k)))
    assert np.isnan(slopes(0.5)).all()
    assert np.isfinite(slopes(3.0)).all()


def blow_up() -> tx.Dynamics:
    x = tx.State("x")
    return tx.compile(tx.System(rates={x: x * x}))


@pytest.mark.parametrize("method", [None, RADAU], ids=["explicit", "Radau"])
def test_a_pole(method: Method | None) -> None:
    """The example that summed gradients and took a failed member for stationary."""
    system = blow_up()

    def end(a: jax.Array) -> jax.Array:
        return tx.integrate(system, {"x": a}, t1=0.9, rtol=1e-7, method=method).xs["x"][-1]

    value, slope = jax.jit(jax.value_and_grad(end))(2.0)
    assert np.isnan(value)
    assert np.isnan(slope)
    np.testing.assert_allclose(jax.jit(jax.value_and_grad(end))(0.5), [0.5 / 0.55, 1.0 / 0.55**2], rtol=1e-5)


def test_saved_rows_that_were_reached_keep_their_derivatives() -> None:
    """A loss that leaves the others out is differentiable; one that does not has NaN."""
    system, times = blow_up(), np.array([0.1, 0.3, 0.8])

    def saved(a: jax.Array) -> jax.Array:
        return tx.integrate(system, {"x": a}, t1=0.9, rtol=1e-9, save_at=times).xs["x"]

    rows, forward, reverse = jax.jit(lambda a: (saved(a), jax.jacfwd(saved)(a), jax.jacrev(saved)(a)))(2.0)
    exact = 2.0 / (1.0 - 2.0 * times[:2])
    np.testing.assert_allclose(rows[:2], exact, rtol=1e-7)
    for slopes in (forward, reverse):
        np.testing.assert_allclose(slopes[:2], 1.0 / (1.0 - 2.0 * times[:2]) ** 2, rtol=1e-6)
        assert np.isnan(slopes[2])


def test_events_phases_dense_output_outputs_and_simulators() -> None:
    x, k = tx.State("x"), tx.Parameter("k", value=1.0)
    system = tx.compile(tx.System(rates={x: k * x * x}, outputs={"twice": 2.0 * x, "k": k + 0.0 * k}))
    event = tx.Event(x - 1e30)
    run = {"t1": 0.9, "rtol": 1e-7}
    simulator = tx.simulator(system, {"x": 0.1}, throw=False, **run)
    phases = [tx.Phase(system, duration=0.2), tx.Phase(system, duration=0.7)]
    control = tx.StepControl(max_steps=300)
    dense = {"dense": True, "control": control, **run}

    def all_of(a: jax.Array, k: jax.Array) -> list[jax.Array]:
        start, params = {"x": a}, {"k": k}
        return [
            tx.integrate(system, start, event=event, params=params, control=control, **run).xs["x"][-1],
            tx.integrate_phases(phases, start, rtol=1e-7, params=params, control=control).xs["x"][-1],
            tx.integrate(system, start, params=params, **dense).evaluate(0.8)["x"],
            *(v[-1] for v in tx.integrate(system, start, params=params, **run).outputs.values()),
            simulator(start, params=params).xs["x"][-1],
        ]

    def both(*inputs: jax.Array) -> Any:
        return jax.jacfwd(all_of, (0, 1))(*inputs), jax.jacrev(all_of, (0, 1))(*inputs)

    several = jax.jit(both)
    assert np.isnan(jax.tree.leaves(several(2.0, 1.0))).all()
    fine = several(0.5, 1.0)
    np.testing.assert_allclose(*map(jax.tree.leaves, fine), rtol=1e-6)
    assert np.isfinite(jax.tree.leaves(fine)).all()


@pytest.mark.parametrize("saved", [None, np.array([0.1, 0.2])], ids=["end", "saved"])
@pytest.mark.parametrize("how", [{"steps": 90}, {"rtol": 1e-7}], ids=["fixed", "tolerances"])
def test_the_time_of_an_event_that_a_failure_prevents(how: dict[str, Any], saved: np.ndarray | None) -> None:
    """x = 1 is met at 1/a - 1; of a = 2 there is a pole at 0.5 s, and no time to be had."""
    system, event = blow_up(), tx.Event(tx.State("x") - 1.0)

    def time(a: jax.Array) -> jax.Array:
        return tx.integrate(system, {"x": a}, t1=0.9, event=event, save_at=saved, throw=False, **how).ts[-1]

    function = jax.jit(jax.vmap(lambda a: (time(a), jax.jacfwd(time)(a), jax.grad(time)(a))))
    found = np.array(function(jnp.array([0.6, 2.0])))
    assert np.isnan(found[:, 1]).all()
    np.testing.assert_allclose(found[:, 0], [1.0 / 0.6 - 1.0, -1.0 / 0.36, -1.0 / 0.36], rtol=1e-5)


def test_crossings_that_were_not_reached() -> None:
    """x = 1 is crossed at 1/a - 1 on the way, x = 1e9 is not: NaN and no zero, unless the loss leaves them out."""
    system, x = blow_up(), tx.State("x")
    events = [tx.Event(x - 1.0, terminal=False), tx.Event(x - 1e9, terminal=False)]

    def rows(a: jax.Array) -> jax.Array:
        run = tx.integrate(system, {"x": a}, t1=0.9, steps=90, event=events, max_crossings=2, throw=False)
        assert run.crossings is not None
        return run.crossings.ts

    both = jax.jit(lambda a: (rows(a), jax.jacfwd(rows)(a), jax.jacrev(rows)(a)))
    values, forward, reverse = both(0.6)
    for found, right in ((values, 1.0 / 0.6 - 1.0), (forward, -1.0 / 0.36), (reverse, -1.0 / 0.36)):
        np.testing.assert_allclose(found[0], right, rtol=1e-5)
        assert np.isnan(found[1])
    np.testing.assert_allclose(jax.jit(jax.grad(lambda a: jnp.nansum(rows(a))))(0.6), -1.0 / 0.36, rtol=1e-5)
