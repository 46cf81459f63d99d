"""`check_group` passes groups that are right, and sees each error that makes one wrong."""

import dataclasses
import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistax as tx
from twistax.groups import ElementPart, Group
from twistax.testing import LawError, check_group
from users_groups import SE2, SIM2, SO2, Similarity


def test_a_group_of_users_passes() -> None:
    check_group(SO2())


@pytest.mark.parametrize("group", [SE2, SIM2], ids=lambda group: group.name)
def test_a_larger_group_of_users_passes(group: Group) -> None:
    check_group(group, seed=3)


@dataclasses.dataclass(frozen=True)
class OtherSign(Similarity):
    def ad(self, d: Any) -> Any:
        return -super().ad(d)


@dataclasses.dataclass(frozen=True)
class LeftForRight(Similarity):
    def left_jacobian(self, d: Any) -> Any:
        return super().left_jacobian(-d)


@dataclasses.dataclass(frozen=True)
class Backwards(Similarity):
    def Ad(self, g: Any) -> Any:
        return super().Ad(self.inverse(g))


@dataclasses.dataclass(frozen=True)
class OnTheLeft(Similarity):
    def retract(self, g: Any, d: Any) -> Any:
        return self.compose(self.exp(d), g)


@dataclasses.dataclass(frozen=True)
class SwappedParts(Similarity):
    @property
    def parts(self) -> tuple[ElementPart, ...]:
        position, shape = super().parts
        return dataclasses.replace(position, place=shape.place), dataclasses.replace(shape, place=position.place)


@dataclasses.dataclass(frozen=True)
class ByArccos(SO2):
    def log(self, g: Any) -> Any:
        return (jnp.arccos(jnp.clip(g[0, 0], -1.0, 1.0)) * jnp.sign(g[1, 0]))[None]


@dataclasses.dataclass(frozen=True)
class NoInverse(SO2):
    def inverse(self, g: Any) -> Any:
        return g


@dataclasses.dataclass(frozen=True)
class BlindToDrift(SO2):
    def defect(self, g: Any) -> Any:
        return jnp.zeros((), g.dtype)


@dataclasses.dataclass(frozen=True)
class Unrepaired(SO2):
    def normalize(self, g: Any) -> Any:
        return g


@dataclasses.dataclass(frozen=True)
class ByDecomposition(SO2):
    """The nearest rotation, whose derivative has 0/0 where singular values are equal: everywhere on the group."""

    def normalize(self, g: Any) -> Any:
        u, _, v = jnp.linalg.svd(g)
        return u @ v


@dataclasses.dataclass(frozen=True)
class Promoting(SO2):
    def identity(self, dtype: Any = None) -> Any:
        return jnp.eye(2, dtype=jnp.float64)


@dataclasses.dataclass(frozen=True)
class AnotherShape(SO2):
    def Ad(self, g: Any) -> Any:
        return jnp.ones(1, g.dtype)


class Changeable(SO2):
    def __eq__(self, other: object) -> bool:
        return self is other


@dataclasses.dataclass(frozen=True)
class OutOfRange(SO2):
    """Right in double precision, not in single: a product leaves its range."""

    def exp(self, d: Any) -> Any:
        return super().exp(d * 1e25 * 1e25 * 1e-25 * 1e-25)


BROKEN: list[tuple[Group, str]] = [
    (OtherSign(scaled=False), "Ad of Exp"),
    (LeftForRight(scaled=False), "left Jacobian is sum"),
    (Backwards(scaled=False), r"Exp\(Ad_g e\)"),
    (OnTheLeft(scaled=False), r"g \(\+\) d = g Exp\(d\).*perturbations act on the right"),
    (SwappedParts(scaled=False), "leaves the part 'position' as it is"),
    (ByArccos(), r"(Log\(Exp\(d\)\) = d|Exp\(Log\(g\)\) = g).*look at log"),
    (NoInverse(), r"Exp\(-d\) = Exp\(d\)\^-1"),
    (BlindToDrift(), "defect notices drift"),
    (Unrepaired(), "normalize repairs drift"),
    (ByDecomposition(), "the derivative of normalize is that of its values.*not by an SVD"),
    (Promoting(), "shape and precision of identity"),
    (AnotherShape(), r"shape and precision of Ad.*got \(\(1,\), 'float64'\) for \(\(1, 1\), 'float64'\)"),
    (Changeable(), "a group is a value.*frozen"),
    (OutOfRange(), "in single precision"),
]


@pytest.mark.parametrize(("group", "words"), BROKEN, ids=lambda value: type(value).__name__)
def test_an_error_is_seen(group: Group, words: str) -> None:
    with pytest.raises(LawError, match=f"(?s){words}") as caught:
        check_group(group)
    assert isinstance(caught.value, AssertionError)
    assert caught.value.law
    assert "\n  fix: " in str(caught.value)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("wrong", [SO2, np.eye(2), "SO2"], ids=str)
def test_what_is_no_group_is_refused(wrong: Any) -> None:
    with pytest.raises(tx.InputError, match=r"check_group expects a group such as tx.SE3 or MyGroup\(\)"):
        check_group(wrong)


def test_nothing_is_changed_by_a_check_and_users_have_no_x64() -> None:
    code = (
        "import sys; sys.path.insert(0, 'tests')\n"
        "import jax, twistax as tx\n"
        "from users_groups import SO2\n"
        "tx.testing.check_group(SO2())\n"
        "print(jax.config.jax_enable_x64, any(name.startswith(('pytest', 'hypothesis')) for name in sys.modules))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.split() == ["False", "False"]
    assert jax.config.jax_enable_x64
