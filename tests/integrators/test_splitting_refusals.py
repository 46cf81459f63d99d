"""What a splitting method cannot solve, it refuses by name: found at random states, before a solution."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from integrator_bodies import spatial_inertia
from splitting_bodies import TENSOR, TOP_BODY, TOP_START, compiled_top, hung

import twistax as tx
from twistax.compositions import STRANG

R, w = tx.State("R", group=tx.SO3), tx.State("w", shape=(3,))
g, V = tx.State("g", group=tx.SE3), tx.State("V", shape=(6,))
p, v, m = tx.State("p", shape=(3,)), tx.State("v", shape=(3,)), tx.State("m")
J = tx.Parameter("J", value=TENSOR)
BODY = tx.FreeBody("R", "w", inertia=TENSOR)


def turning(torque: Any = 0.0, inertia: Any = TENSOR, rate: Any = w, **others: Any) -> dict[Any, Any]:
    return {R: rate, w: tx.linalg.Solve(inertia, tx.linalg.Cross(inertia @ w, w) + torque * tx.Constant(np.ones(3)))}


def refused(rates: dict[Any, Any], *bodies: Any) -> str:
    with pytest.raises(tx.ModelError) as caught:
        tx.Splitting(STRANG, list(bodies)).check(tx.compile(tx.System(rates=rates)))
    assert "\n  fix: " in str(caught.value)
    return str(caught.value).splitlines()[0]


def test_a_state_that_no_body_covers() -> None:
    assert refused(turning() | {m: -0.1 * m}, BODY) == "Splitting: no body covers state 'm'."


def test_a_rate_that_is_not_the_velocity() -> None:
    message = refused(turning(rate=2.0 * w), BODY)
    assert message == "Splitting: the rate of 'R' is not the velocity of FreeBody(pose='R', velocity='w')."
    assert "rate of 'p'" in refused({p: v + 0.1 * p, v: -p}, tx.FreeParticle(p, v))


@pytest.mark.parametrize("large", [1.0, 1e14])
def test_drag_beside_any_other_force(large: float) -> None:
    """A force of 1e14 does not hide a weak drag."""
    rates = {p: v, v: -large * p - 1e-3 * v}
    assert "'v' depends on velocities also near rest: drag" in refused(rates, tx.FreeParticle("p", "v"))


def test_drag_that_vanishes_at_rest() -> None:
    rates = turning(torque=-0.01 * tx.linalg.Norm(w) ** 2)
    assert "the rate of 'w' depends on velocities in another way" in refused(rates, BODY)


def test_a_damper_between_two_parts() -> None:
    rates = turning(torque=0.1 * v[0]) | {p: v, v: -p}
    assert "the rate of 'w' depends on velocities also near rest" in refused(rates, BODY, tx.FreeParticle("p", "v"))


def test_another_inertia() -> None:
    other = tx.FreeBody("R", "w", inertia=TENSOR + 1e-5 * np.diag([1.0, 0.0, 0.0]))
    message = refused(turning(), other)
    assert "the rate of 'w' depends on velocities in another way than that of FreeBody(" in message


def test_another_center_of_mass() -> None:
    system = hung()
    other = tx.FreeBody("g", "V", inertia=spatial_inertia(centre=np.array([0.1, -0.2, 0.31])))
    assert "'V' depends on velocities in another way" in refused(system.rates, other)


def test_an_inertia_that_is_a_parameter_of_the_system_and_given_as_numbers() -> None:
    """It would fit as long as the parameter keeps its value."""
    message = refused(turning(inertia=J), BODY)
    assert "depends on parameters of the system that its argument inertia does not contain" in message
    baked = tx.compile(tx.System(rates=turning(inertia=J)), bake={"J": TENSOR})
    tx.Splitting(STRANG, BODY).check(baked)
    tx.Splitting(STRANG, tx.FreeBody("R", "w", inertia="J")).check(tx.compile(tx.System(rates=turning(inertia=J))))


def test_another_parameter_of_equal_value() -> None:
    K = tx.Parameter("K", value=TENSOR)
    rates = turning(inertia=J, torque=K[0, 0])
    assert "its argument inertia does not contain" in refused(rates, tx.FreeBody(R, w, inertia=K))


@pytest.mark.parametrize(
    ("rates", "body", "message"),
    [
        (turning(), tx.FreeBody("R", "q", inertia=TENSOR), "'q' is not a state of the system; it has: 'R', 'w'"),
        (turning() | {p: v, v: -p}, tx.FreeBody("R", "p", inertia=TENSOR), "no body covers state 'w'"),
        ({p: v, v: -p}, tx.FreeBody("p", "v", inertia=TENSOR), "state 'p' is not a rotation or a pose"),
        (turning(), tx.FreeParticle("R", "w"), "two states without a group"),
        (turning(), tx.FreeBody("R", "w", inertia=np.eye(6)), r"shape \(3,\) or \(3, 3\) on SO3, got \(6, 6\)"),
        (turning(), tx.FreeBody("R", "w", inertia=-TENSOR), "positive principal moments"),
        (turning(), tx.FreeBody("R", "w", inertia="J"), "reads parameter 'J', which the system does not have"),
        ({g: V, V: V * 0.0}, tx.FreeBody("g", "V", inertia=[1.0, 2.0, 1.0, 1.0, 1.0, 1.0]), "not the spatial inertia"),
        (turning(), (BODY, BODY), "belongs to two parts"),
    ],
)  # fmt: skip
def test_refuses(rates: Any, body: Any, message: str) -> None:
    with pytest.raises(tx.ModelError, match=message):
        tx.Splitting(STRANG, body).check(tx.compile(tx.System(rates=rates)))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tx.Splitting(tx.tableaus.RK4, BODY), "a composition like tx.compositions.KAHAN_LI8"),
        (lambda: tx.Splitting(STRANG, []), "bodies like tx.FreeBody"),
        (lambda: tx.Splitting(STRANG, ["R"]), "bodies like tx.FreeBody"),
        (lambda: tx.FreeParticle("p", 3), "states or their names, got 3"),
        (lambda: tx.FreeBody(2.0 * w, "w", inertia=TENSOR), "states or their names"),
        (lambda: tx.FreeBody("R", inertia=TENSOR), "either velocity=... or momentum=..."),
        (lambda: tx.FreeBody("R", "w", momentum="L", inertia=TENSOR), "either velocity=... or momentum=..."),
        (lambda: tx.FreeBody("R", "w", inertia=J * w[0]), "an expression of parameters"),
        (lambda: tx.FreeBody("R", "w", inertia=[1.0, np.nan, 1.0]), "finite"),
        (lambda: tx.FreeBody("R", "w", inertia="J", mass=2.0), None),
    ],
)
def test_constructors_refuse(make: Any, message: str | None) -> None:
    with pytest.raises(TypeError if message is None else tx.ModelError, match=message):
        make()


def test_steps_chosen_by_tolerances_are_refused_with_the_way_out() -> None:
    with pytest.raises(tx.ModelError, match=r"does not estimate its error(.|\n)*fix: pass dt or steps"):
        tx.integrate(compiled_top(), TOP_START, t1=1.0, rtol=1e-6, method=tx.Splitting(STRANG, TOP_BODY))


def test_methods_are_values() -> None:
    same, other = tx.FreeBody(R, w, inertia=TENSOR.copy()), tx.FreeBody(R, w, inertia=2.0 * TENSOR)
    assert tx.Splitting(STRANG, [same]) == tx.Splitting(STRANG, TOP_BODY)
    assert hash(tx.Splitting(STRANG, [same])) == hash(tx.Splitting(STRANG, TOP_BODY))
    assert tx.Splitting(STRANG, other) != tx.Splitting(STRANG, TOP_BODY)
    assert tx.FreeBody(R, w, inertia=J) == tx.FreeBody(R, w, inertia=tx.Parameter("J", value=TENSOR))


def test_a_solution_inside_jit_is_checked_too() -> None:
    dynamics = tx.compile(tx.System(rates=turning(torque=0.1 * w[0])))

    @jax.jit
    def end(w0: jax.Array) -> jax.Array:
        x0 = {"R": jnp.eye(3), "w": w0}
        return tx.integrate(dynamics, x0, t1=1.0, steps=3, method=tx.Splitting(STRANG, BODY)).xs["w"]

    with pytest.raises(tx.ModelError, match="near rest"):
        end(jnp.ones(3))
