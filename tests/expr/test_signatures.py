"""What editors and `help` show of a constructor is what it takes."""

import inspect

import pytest

from twistax import expr as tx
from twistax.expr import lie

NODES = {cls.__name__: cls for cls in tx.all_nodes()}
LEAVES = {
    "State": ["name", "shape", "group", "order", "min", "max", "initial", "final", "guess", "scale", "kind", "unit"],
    "Control": ["name", "shape", "min", "max", "guess", "scale", "kind", "unit"],
    "Parameter": ["name", "shape", "value", "kind", "unit"],
    "Constant": ["value", "kind", "unit"],
    "Time": [],
}


def example_of(cls: type[tx.Expr]) -> tx.Expr:
    return next(case.expr for case in cls.example() if type(case.expr) is cls)


def shown(cls: type[tx.Expr]) -> list[inspect.Parameter]:
    return list(inspect.signature(cls).parameters.values())


@pytest.mark.parametrize("name", LEAVES)
def test_leaves_show_what_they_take(name: str) -> None:
    assert [p.name for p in shown(NODES[name])] == LEAVES[name]


@pytest.mark.parametrize("name", sorted(set(NODES) - {"Vmap"}))
def test_every_parameter_shown_is_taken(name: str) -> None:
    """A node is built again of what its class shows, each parameter by its name; nothing else is taken."""
    cls = NODES[name]
    node = example_of(cls)
    operands: list[tx.Expr] = []
    named = {}
    for parameter in shown(cls):
        if parameter.kind is inspect.Parameter.VAR_POSITIONAL:
            operands = getattr(node, parameter.name)
        else:
            assert parameter.kind is not inspect.Parameter.VAR_KEYWORD
            named[parameter.name] = getattr(node, parameter.name)
    assert cls(*operands, **named).key() == node.key()
    with pytest.raises(TypeError):
        cls(*operands, **named, unknown=1)
    for parameter in shown(cls):
        if parameter.name in named and parameter.default is inspect.Parameter.empty:
            with pytest.raises(TypeError):
                cls(*operands, **{key: value for key, value in named.items() if key != parameter.name})


def test_a_vmap_shows_its_function_and_its_batch() -> None:
    assert [p.name for p in shown(tx.Vmap)] == ["fn", "batch", "axis"]


def test_what_may_be_left_out_and_what_is_by_name_only() -> None:
    state = inspect.signature(tx.State).parameters
    assert state["name"].default is inspect.Parameter.empty
    assert state["shape"].kind is inspect.Parameter.POSITIONAL_OR_KEYWORD
    assert state["group"].kind is inspect.Parameter.KEYWORD_ONLY
    assert [str(p) for p in shown(lie.Adjoint)] == ["twist1", "twist2", "order=LINEAR_FIRST"]
