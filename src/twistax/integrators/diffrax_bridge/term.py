"""The term of a system on groups, and how a solver reads it."""

from __future__ import annotations

from typing import Any, NamedTuple, NoReturn

import diffrax
import equinox as eqx

from ...errors import ModelError
from ...jax_inside import wrapped_terms
from ...lowering import Dynamics
from ...lowering.dynamics import Arrays, not_compiled
from ..ambient import read_arguments

__all__ = ["LieTerm", "LieTerms", "Part", "lie_term", "parts_of"]


class LieTerm(diffrax.AbstractTerm):
    """A system as a term for `LieSolver`. Its rates are body velocities: no solver can add them to a state."""

    dynamics: Dynamics = eqx.field(static=True)

    def vf(self, t: Any, y: Any, args: Any) -> Arrays:
        """The rates at y with args = (u, params), or None. Raises InputError as a call of the dynamics does."""
        return read_arguments(self.dynamics, t, y, args).rates(self.dynamics)

    def contr(self, t0: Any, t1: Any, **kwargs: Any) -> Any:
        """The length of the step."""
        return t1 - t0

    def prod(self, vf: Any, control: Any) -> NoReturn:
        """Raises ModelError: a solver that asks for it would add body velocities to poses."""
        raise ModelError(
            "a term of tx.diffrax.lie_term gives body velocities, which a plain solver cannot add to poses.\n"
            "  fix: wrap the solver, tx.diffrax.LieSolver(diffrax.Tsit5(), dynamics), or give a plain solver "
            "tx.diffrax.ambient_term(dynamics). BacksolveAdjoint with a solver of its own ends here too: leave it out"
        )


def lie_term(dynamics: Dynamics) -> LieTerm:
    """A system as a term for `LieSolver`, with args = (u, params) as `tx.integrate` takes them, or None.

    Raises:
        ModelError: no compiled system.
    """
    if not isinstance(dynamics, Dynamics):
        raise not_compiled("lie_term", dynamics)
    return LieTerm(dynamics)


class _Refusing(type(diffrax.AbstractTerm)):  # type: ignore[misc]
    """Says what is wrong with a term, where diffrax would only say that it does not fit."""

    def __instancecheck__(cls, term: Any) -> bool:
        return bool(parts_of(term))


class LieTerms(diffrax.AbstractTerm, metaclass=_Refusing):
    """What `LieSolver` takes: a term of `lie_term`, or a MultiTerm of such. Others raise ModelError with the reason."""


class Part(NamedTuple):
    """One system among the terms, and the sense of time: 1, or -1 where diffrax integrates backwards."""

    dynamics: Dynamics
    direction: Any


def parts_of(terms: Any) -> tuple[Part, ...]:
    """The systems in what diffrax passes to a solver or a controller; several where it was a MultiTerm.

    Raises:
        ModelError: another term, or the adjoint of one.
    """
    members = terms.terms if isinstance(terms, diffrax.MultiTerm) else (terms,)
    return tuple(_part(member) for member in members)


def _part(term: Any) -> Part:
    WrapTerm, AdjointTerm = wrapped_terms()
    direction: Any = 1
    while isinstance(term, WrapTerm):
        direction, term = direction * term.direction, term.term
    if isinstance(term, AdjointTerm):
        raise ModelError(
            "BacksolveAdjoint cannot work on groups: it integrates the state backwards together with an adjoint that "
            "would have to live in the cotangent space of every pose.\n"
            "  fix: leave adjoint out, or take diffrax.RecursiveCheckpointAdjoint(); for forward derivatives "
            "diffrax.ForwardMode()"
        )
    if not isinstance(term, LieTerm):
        raise ModelError(
            f"tx.diffrax.LieSolver and tx.diffrax.controller need terms of tx.diffrax.lie_term, got "
            f"{type(term).__name__}.\n"
            "  fix: diffeqsolve(tx.diffrax.lie_term(dynamics), tx.diffrax.LieSolver(...), ...); with a plain term take "
            "a plain solver and diffrax.PIDController"
        )
    return Part(term.dynamics, direction)
