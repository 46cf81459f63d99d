"""What a System holds; what it refuses is in tests/bad_calls."""

import numpy as np

import twistax as tx

g = tx.State("g", group=tx.SE3)
R = tx.State("R", group=tx.SO3)
V, s = tx.State("V", (6,)), tx.State("s")
F = tx.Control("F", (6,))
p = tx.Parameter("p", value=2.0)
ZERO = np.zeros(6)

# ---- what a System holds -----------------------------------------------------------------------------------------


def test_leaves_in_order_of_declaration() -> None:
    a, b = tx.State("zeta"), tx.State("alpha", group=tx.SO3)
    u, w = tx.Control("w"), tx.Control("a")
    system = tx.System(rates={a: u, b: w * np.ones(3)}, parameters=[p])
    assert [leaf.name for leaf in system.states] == ["zeta", "alpha"]
    assert list(system.rates) == ["zeta", "alpha"]
    assert [leaf.name for leaf in system.controls] == ["w", "a"]
    assert system.parameters == (p,)
    assert system.group.slices == {"zeta": slice(0, 1), "alpha": slice(1, 4)}
    assert repr(system) == "System(states=['zeta', 'alpha'], controls=['w', 'a'], parameters=['p'])"
    ordered = tx.System(rates={a: u, b: w * np.ones(3)}, controls=[w, u])
    assert [leaf.name for leaf in ordered.controls] == ["a", "w"]


def test_keys_may_be_names_and_rates_numbers() -> None:
    system = tx.System(rates={"V": F + 0.0 * V, g: ZERO, s: 1.0})
    assert [leaf.name for leaf in system.states] == ["V", "g", "s"]
    assert system.states[0] is V


def test_one_name_with_equal_leaves_is_one_leaf() -> None:
    again = tx.State("V", (6,))
    system = tx.System(rates={V: F - again}, controls=[F, F])
    assert system.states == (V,)
    assert system.controls == (F,)


def test_constraints_get_names() -> None:
    limit = tx.linalg.Norm(F) <= 10.0
    system = tx.System(rates={V: F}, constraints=[limit, limit, V[0] == 0.0])
    assert list(system.constraints) == ["Norm(F) <= 10.", "Norm(F) <= 10. (2)", "V[0] == 0."]
    assert list(tx.System(rates={V: F}, constraints={"thrust": limit}).constraints) == ["thrust"]
    assert list(tx.System(rates={V: F}, constraints=limit).constraints) == ["Norm(F) <= 10."]
