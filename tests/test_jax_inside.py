"""What is read of JAX's inside sits in one folder, holds on the JAX that is installed, and gives way to plain JAX."""

import ast
import re
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax import jax_inside

SOURCE = Path(tx.__file__).parent

#: Not documented, or documented as subject to change without notice.
INSIDE = re.compile(
    r"jax\._src|jax\.extend|jax\.interpreters|jax\.core|jax\.experimental|jaxlib|diffrax\._|equinox\.internal|optimistix\._"
)


def names_used(text: str) -> set[str]:
    """The dotted names that a module imports or reads."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and not node.level:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Attribute):
            found.add(ast.unparse(node))
    return found


def test_no_other_folder_reads_the_inside_of_jax() -> None:
    others = {
        f"{path.relative_to(SOURCE)}: {name}"
        for path in SOURCE.rglob("*.py")
        if path.parent != SOURCE / "jax_inside"
        for name in names_used(path.read_text())
        if INSIDE.match(name)
    }
    assert others == set()


@pytest.mark.parametrize(
    "text",
    [
        "from jax._src import core",
        "from jax.extend.core import Jaxpr",
        "import jax.experimental.sparse",
        "import jax\nx = jax.core.Tracer",
        "from equinox.internal import unvmap_any",
        "from diffrax._term import WrapTerm",
    ],
)
def test_the_check_sees_what_it_is_for(text: str) -> None:
    assert any(INSIDE.match(name) for name in names_used(text))


def recursion(c: jax.Array, x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """A scan with one constant, two carried values and one scanned array."""

    def body(carry: tuple[jax.Array, jax.Array], row: jax.Array) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        a, b = carry
        return (a * c + row.sum(), b - a), a * row

    (a, b), rows = jax.lax.scan(body, (jnp.ones(()), jnp.zeros(())), x)
    return a + b, rows


ARGUMENTS = (np.float64(0.5), np.arange(6.0).reshape(3, 2))


def equation(function: Any, *arguments: Any) -> Any:
    """The last equation of a function."""
    return jax.make_jaxpr(function)(*arguments).jaxpr.eqns[-1]


def test_parts_of_a_scan() -> None:
    jaxpr = jax.make_jaxpr(recursion)(*ARGUMENTS).jaxpr
    (scan,) = [e for e in jaxpr.eqns if e.primitive.name == "scan"]
    assert jax_inside.scan_parts(scan) == (1, 2)
    assert [len(inner.jaxpr.invars) for inner in jax_inside.inner_jaxprs(scan)] == [4]


def test_parameters_must_be_all_known() -> None:
    reduce = equation(lambda x: jnp.sum(x, axis=0), np.ones((2, 3)))
    names = set(reduce.params)
    assert jax_inside.parameters(reduce, {"something"}, names) is reduce.params
    for other in (names | {"later"}, names - {"axes"}):
        with pytest.raises(jax_inside.Unread, match=rf"JAX {re.escape(jax.__version__)} gives reduce_sum"):
            jax_inside.parameters(reduce, other)


def test_one_equation_alone() -> None:
    jaxpr = jax.make_jaxpr(lambda x, y: jnp.sin(x) * y)(1.0, 2.0).jaxpr
    product = jaxpr.eqns[-1]
    one = jax_inside.alone(jaxpr, product, product.invars)
    assert jax_inside.jaxpr_as_fun(one)(jnp.asarray(3.0), jnp.asarray(4.0)) == [12.0]


def test_any_of_a_batch() -> None:
    found = jax.vmap(lambda c: jnp.where(jax_inside.any_of_batch(c), 1, 0))(jnp.array([False, True]))
    assert found.tolist() == [1, 1]


def test_terms_of_diffrax() -> None:
    import diffrax

    turned, adjoint = jax_inside.wrapped_terms()
    assert issubclass(turned, diffrax.AbstractTerm)
    assert issubclass(adjoint, diffrax.AbstractTerm)
