"""Every static field of every node enters the key by its content: what the code takes for one node is one node."""

import copy
import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from expr_cases import NODES

import twistax as tx
from twistax.errors import ModelError
from twistax.expr import Expr

#: Another value of a field: by its name, or by that of its class before it. A new field needs a row.
OTHER: dict[str, Callable[[Any], Any]] = {
    "order": lambda order: tx.ANGULAR_FIRST if order is tx.LINEAR_FIRST else tx.LINEAR_FIRST,
    "inverse": lambda inverse: not inverse,
    "copies": lambda copies: not copies,
    "columns": lambda columns: columns + 1,
    "index": lambda index: (index, None),
    "delta": lambda delta: np.nextafter(delta, 2.0),
    "c": lambda c: np.nextafter(c, 2.0),
    "xp": lambda xp: np.nextafter(xp, 9.0),
    "fp": lambda fp: np.nextafter(fp, 9.0),
    "method": lambda method: "pchip" if method == "cubic" else "cubic",
    "ord": lambda ord: "fro" if ord == 2 else 2,
    "axes": lambda axes: (*axes[:-1], np.nextafter(axes[-1], 9.0)),
    "values": lambda values: np.nextafter(values, 9.0),
    "kind": lambda kind: tx.tables.Linear() if kind != tx.tables.Linear() else tx.tables.BSpline(),
    "outside": lambda outside: tx.tables.Clamped() if outside != tx.tables.Clamped() else tx.tables.Refused(),
    "sequence": lambda sequence: sequence[::-1].swapcase(),
    "model": lambda model: dataclasses.replace(model, radius=np.nextafter(model.radius, 9.0)),
    "tolerance": lambda tolerance: np.nextafter(tolerance, 1.0).item(),
    "blocks": lambda blocks: (*blocks, 1),
    "density": lambda density: density + 1.0,
    "unit": lambda unit: np.nextafter(unit, 9.0).item(),
    "name": lambda name: f"{name}_",
    "Constant.name": lambda name: None,
    "Time.name": lambda name: None,
    "Constant.value": lambda value: np.nextafter(value, 9.0),
    "group": lambda group: tx.SE3 if group is not tx.SE3 else tx.SO3,
    "AxisRotation.axis": lambda axis: axis[1:] + axis[:1],
    "Vmap.axis": lambda axis: axis + 1,
    "Rate.depth": lambda depth: depth + 1,
    "along": lambda along: along[::-1],
    "body": lambda body: body + 1.0,
    "placeholders": lambda placeholders: placeholders[::-1] + placeholders[:1],
    "air": lambda air: dataclasses.replace(air, molar_mass=np.nextafter(air.molar_mass, 99.0)),
    "operand": lambda operand: (
        operand.replace(name=f"{operand.name}_") if isinstance(operand, tx.State) else operand + 1.0
    ),
    "Call.f": lambda f: lambda *arguments: f(*arguments),
    "result_shape": lambda shape: (*(shape or ()), 1),
    "trees": lambda trees: (*trees, tx.ParameterTree("other", {"a": np.ones(2)})),
    "target": lambda target: (*target, 1),
    "ellipsoid": lambda ellipsoid: dataclasses.replace(ellipsoid, radius=np.nextafter(ellipsoid.radius, 9e9)),
}
#: A leaf is its kind, name and shape; what else it declares a system compares where two of a name meet. The names of
#: the others are what they are printed as.
LEAVES_SAY = {"min", "max", "guess", "scale", "initial", "final", "Parameter.value", "Constant.name", "Time.name"}
LEAVES_SAY |= {f"{kind}.name" for kind in ("Initial", "Integral", "Maximum", "Minimum")}

FIELDS = [(node, f.name) for node in NODES for f in node._fields if not (f.operand or f.variadic)]


def changed(node: Expr, name: str, value: Any) -> Expr:
    """The same node with another value of a field, whatever its constructor would say."""
    other = object.__new__(type(node))
    other.__dict__.update(node.__dict__ | {name: value})
    other.__dict__.pop("_key", None)
    return other


@pytest.mark.parametrize(("node", "name"), FIELDS, ids=lambda part: getattr(part, "__name__", part))
def test_a_static_field_enters_the_key(node: type[Expr], name: str) -> None:
    own = f"{node.__name__}.{name}"
    if {name, own} & LEAVES_SAY:
        assert issubclass(node, tx.Leaf)
        return
    examples = [example.expr for example in node.example() if isinstance(example.expr, node)]
    for expr in examples:
        value = (OTHER.get(own) or OTHER[name])(getattr(expr, name))
        assert changed(expr, name, value).key() != expr.key()
        assert changed(expr, name, copy.deepcopy(getattr(expr, name))).key() == expr.key()


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (tx.State("x"), tx.State("x", min=0.0)),
        (tx.State("x"), tx.State("x", initial=1.0)),
        (tx.Control("x"), tx.Control("x", guess=1.0)),
        (tx.Parameter("x", value=1.0), tx.Parameter("x", value=2.0)),
    ],
)
def test_leaves_of_a_name_say_the_same(one: Expr, other: Expr) -> None:
    y = tx.State("y")
    rates = {y: one + tx.Sin(other)} | ({one: 0.0} if isinstance(one, tx.State) else {})
    with pytest.raises(ModelError, match="'x'"):
        tx.System(rates)
