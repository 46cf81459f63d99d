"""Equations on whole batches, as `jax.vmap` produces them, as functions of one member.

The batch ends at an equation for which no rule keeps the members separate. The equations of a batch can always be
executed member by member.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ...jax_inside import ClosedJaxpr, Literal, Unread, alone, closed, jaxpr_as_fun, parameters, scan_parts
from .inlining import inlined, value_of
from .member_rules import RULES, Axes, Mixed, Rule, length_of, of_length_one

#: Operations of all members with an array of more entries, as a product with a large matrix, are left to XLA.
_MOST_SHARED = 1024


class OneMember(NamedTuple):
    """An equation on one member, along an axis of length one.

    Attributes:
        operands, results: the axes of the batch; operands may be more than those that were known.
        run: the equation on arrays in which this axis has length one.
    """

    operands: Axes
    results: Axes
    run: Callable[..., Sequence[Any]]


def _of_python(axes: Axes) -> Axes:
    """Axes as `jax.vmap` takes them; those that JAX's rules for gathers compute are integers of NumPy."""
    return [None if axis is None else int(axis) for axis in axes]


def one_member(eqn: Any, size: int, axes: Axes) -> OneMember:
    """An equation on one member.

    Args:
        size: the length of the batch.
        axes: the axes of the operands that are known, at least one.
    Raises:
        Mixed: it mixes members, or suits arrays better.
    """
    rule = _LOOPS.get(eqn.primitive.name) or RULES.get(eqn.primitive.name)
    if rule is None:
        raise Mixed
    operands, results, changed = rule(eqn, size, axes)
    operands, results = map(_of_python, (operands, results))
    shared = [v.aval.size for v, axis in zip(eqn.invars, operands, strict=True) if axis is None]
    if eqn.primitive.name not in _LOOPS and max(shared, default=0) > _MOST_SHARED:
        raise Mixed
    if any(known is not None and known != axis for known, axis in zip(axes, operands, strict=True)):
        raise Mixed
    for v, axis in zip((*eqn.invars, *eqn.outvars), (*operands, *results), strict=True):
        if axis is not None and length_of(v, axis) != size:
            raise Mixed
    params = {**eqn.params, **changed}

    def run(*values: Any) -> Sequence[Any]:
        outputs = eqn.primitive.bind(*values, **params)
        return outputs if eqn.primitive.multiple_results else [outputs]

    return OneMember(operands, results, run)


def spread_out(eqn: Any, size: int) -> OneMember | None:
    """An equation that only repeats something for each member; None for other equations."""
    if eqn.primitive.name != "broadcast_in_dim" or len(eqn.invars) != 1:
        return None
    shape, kept = eqn.params["shape"], eqn.params["broadcast_dimensions"]
    new = [i for i, length in enumerate(shape) if length == size and i not in kept]
    if not new:
        return None
    params = {**eqn.params, "shape": of_length_one(shape, new[0])}
    return OneMember([None], [new[0]], lambda value: [eqn.primitive.bind(value, **params)])


# ---- loops and branches ----------------------------------------------------------------------------------------------


class BodyOfMember:
    """The jaxpr of a body whose equations all keep members separate, for one member.

    Attributes:
        operands, results: the axes of its arguments and results.

    Args:
        axes: those of the arguments that are known. More of them may have one.
        wanted: the axes that results must have, where they are known.
    Raises:
        Mixed: an equation mixes members.
    """

    def __init__(self, body: ClosedJaxpr, size: int, axes: Axes, wanted: Axes) -> None:
        self._body, self._size, self.operands = inlined(body), size, list(axes)
        while not self._go(wanted):
            pass

    def _go(self, wanted: Axes) -> bool:
        """Find the axes of all variables; False where an argument has to have one that was not known."""
        jaxpr = self._body.jaxpr
        axis = {v: a for v, a in zip(jaxpr.invars, self.operands, strict=True) if a is not None}
        self._steps: list[tuple[Any, OneMember | None]] = []
        for eqn in jaxpr.eqns:
            known, member = axes_of(eqn.invars, axis), spread_out(eqn, self._size)
            if any(a is not None for a in known):
                member = one_member(eqn, self._size, known)
                if self._asks(eqn.invars, known, member.operands):
                    return False
            self._steps.append((eqn, member))
            axes = zip(eqn.outvars, member.results if member else [None] * len(eqn.outvars), strict=True)
            axis.update((v, a) for v, a in axes if a is not None)
        self.results: Axes = axes_of(jaxpr.outvars, axis)
        return not self._asks(jaxpr.outvars, self.results, wanted)

    def _asks(self, variables: Sequence[Any], known: Axes, wanted: Axes) -> bool:
        """Whether an argument gets an axis that it did not have: itself, or for what is computed of it."""
        for v, old, new in zip(variables, known, wanted, strict=True):
            if old is None and new is not None:
                arguments = self._body.jaxpr.invars
                if v in arguments and length_of(v, new) == self._size:
                    self.operands[arguments.index(v)] = new
                    return True
                return self._begins(v)
        return False

    def _begins(self, v: Any) -> bool:
        """Give the first argument on which a variable depends, and which has axes of this length, such an axis."""
        jaxpr, needed = self._body.jaxpr, {v}
        for eqn in reversed(jaxpr.eqns):
            if not needed.isdisjoint(eqn.outvars):
                needed.update(u for u in eqn.invars if not isinstance(u, Literal))
        for k, argument in enumerate(jaxpr.invars):
            if argument in needed and self.operands[k] is None and self._size in argument.aval.shape:
                self.operands[k] = argument.aval.shape.index(self._size)
                return True
        raise Mixed

    @property
    def jaxpr(self) -> ClosedJaxpr:
        """The body for arrays with an axis of length one."""
        jaxpr = self._body.jaxpr

        def run(*values: Any) -> list[Any]:
            env = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*self._body.consts, *values], strict=True))
            for eqn, member in self._steps:
                env.update(zip(eqn.outvars, _evaluated(jaxpr, eqn, member, env), strict=True))
            return [value_of(v, env) for v in jaxpr.outvars]

        shapes = [
            jax.ShapeDtypeStruct(v.aval.shape if a is None else of_length_one(v.aval.shape, a), v.aval.dtype)
            for v, a in zip(jaxpr.invars, self.operands, strict=True)
        ]
        return jax.make_jaxpr(run)(*shapes)


def axes_of(variables: Sequence[Any], axis: Mapping[Any, int]) -> Axes:
    """The axes of variables; numbers have none."""
    return [None if isinstance(v, Literal) else axis.get(v) for v in variables]


def _evaluated(jaxpr: Any, eqn: Any, member: OneMember | None, env: dict[Any, Any]) -> Sequence[Any]:
    """The results of an equation, on one member or, where it has no batch, as it is."""
    if member is not None:
        return member.run(*(value_of(v, env) for v in eqn.invars))
    variables = list(dict.fromkeys(v for v in eqn.invars if not isinstance(v, Literal)))
    return jaxpr_as_fun(alone(jaxpr, eqn, variables))(*(env[v] for v in variables))


def _joined(before: Axes, after: Axes) -> Axes:
    """The axes of what is carried: those that it has before or after an iteration."""
    if any(a is not None and b is not None and a != b for a, b in zip(before, after, strict=True)):
        raise Mixed
    return [b if a is None else a for a, b in zip(before, after, strict=True)]


def _scan(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    try:
        fixed, carried = scan_parts(eqn)
    except Unread:
        raise Mixed from None
    rows = slice(fixed + carried, None)
    if 0 in axes[rows]:
        raise Mixed
    inner = [*axes[: fixed + carried], *(None if a is None else a - 1 for a in axes[rows])]
    stacked = len(eqn.outvars) - carried
    while True:
        carry = inner[fixed : fixed + carried]
        body = BodyOfMember(closed(eqn.params["jaxpr"]), size, inner, [*carry, *[None] * stacked])
        after = _joined(body.operands[fixed : fixed + carried], body.results[:carried])
        if body.operands == inner and after == carry:
            break
        inner = [*body.operands[:fixed], *after, *body.operands[rows]]
    operands = [*inner[: fixed + carried], *(None if a is None else a + 1 for a in inner[rows])]
    results = [*carry, *(None if a is None else a + 1 for a in body.results[carried:])]
    return operands, results, {"jaxpr": body.jaxpr}


def _cond(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    """A branch that all members take alike."""
    if axes[0] is not None:
        raise Mixed
    operands, results = axes[1:], list[int | None]([None] * len(eqn.outvars))
    while True:
        bodies = [BodyOfMember(closed(branch), size, operands, results) for branch in eqn.params["branches"]]
        before = operands, results
        operands = functools.reduce(_joined, [body.operands for body in bodies])
        results = functools.reduce(_joined, [body.results for body in bodies])
        if (operands, results) == before:
            return [None, *operands], results, {"branches": tuple(body.jaxpr for body in bodies)}


def _while(eqn: Any, size: int, axes: Axes) -> tuple[Axes, Axes, Mapping[str, Any]]:
    """Where members end by themselves JAX's condition has their axes, and selects."""
    try:
        p = parameters(eqn, {"body_jaxpr", "body_nconsts", "cond_jaxpr", "cond_nconsts"})
    except Unread:
        raise Mixed from None
    asking, fixed = p["cond_nconsts"], p["cond_nconsts"] + p["body_nconsts"]
    by_member = closed(p["cond_jaxpr"]).jaxpr.outvars[0].aval.ndim > 0
    ends: Axes = [next((a for a in axes[fixed:] if a is not None), 0) if by_member else None]
    operands = list(axes)
    while True:
        carried = ends * len(axes[fixed:]) if by_member else operands[fixed:]
        body = BodyOfMember(closed(p["body_jaxpr"]), size, [*operands[asking:fixed], *carried], carried)
        count = fixed - asking
        going = BodyOfMember(closed(p["cond_jaxpr"]), size, [*operands[:asking], *body.operands[count:]], ends)
        after = _joined(_joined(body.operands[count:], going.operands[asking:]), body.results)
        joined = [*going.operands[:asking], *body.operands[:count], *after]
        if joined == operands:
            break
        operands = joined
    if going.results != ends:
        raise Mixed
    return operands, after, {"cond_jaxpr": going.jaxpr, "body_jaxpr": body.jaxpr}


_LOOPS: Mapping[str, Rule] = {"scan": _scan, "cond": _cond, "while": _while}


# ---- a batch among other equations -----------------------------------------------------------------------------------


class BatchEquations:
    """The equations of a jaxpr that keep the members of a batch separate.

    Attributes:
        size: the length of the batch.
        members: by the identity of the equation.
    """

    def __init__(self, jaxpr: Any, size: int) -> None:
        self.size, self.members = size, dict[int, OneMember]()
        self._axis: dict[Any, int] = {}
        #: Results that all members share, and variables that repeat something for each member.
        self._alike: set[Any] = set()
        self._copies: dict[Any, tuple[Any, OneMember]] = {}
        for eqn in jaxpr.eqns:
            copy, known = spread_out(eqn, size), axes_of(eqn.invars, self._axis)
            if copy is not None and known == [None]:
                self._copies[eqn.outvars[0]] = (eqn.invars[0], copy)
            elif (member := self._member(eqn, known)) is not None:
                self.members[id(eqn)] = member
                axes = list(zip(eqn.outvars, member.results, strict=True))
                self._axis.update((v, a) for v, a in axes if a is not None)
                self._alike.update(v for v, a in axes if a is None)

    def _member(self, eqn: Any, known: Axes) -> OneMember | None:
        for axes in [known] if any(a is not None for a in known) else self._starts(eqn):
            try:
                member = one_member(eqn, self.size, axes)
            except Mixed:
                continue
            pairs = zip(eqn.invars, member.operands, strict=True)
            if not any(a is not None and not isinstance(v, Literal) and v in self._alike for v, a in pairs):
                return member
        return None

    def _starts(self, eqn: Any) -> Iterator[Axes]:
        """The axes that an operand from elsewhere may have."""
        for k, v in enumerate(eqn.invars):
            if not isinstance(v, Literal) and self.size in v.aval.shape:
                axis = self._copies[v][1].results[0] if v in self._copies else v.aval.shape.index(self.size)
                yield [axis if j == k else None for j in range(len(eqn.invars))]

    def on_one(self, eqns: Sequence[Any], outputs: Sequence[Any]) -> MemberFunction:
        """Some of the equations, in their order, as a function of one member."""
        made = {v for eqn in eqns for v in eqn.outvars}
        steps: list[tuple[OneMember, list[Any], list[Any]]] = []
        names: dict[tuple[Any, int | None], bool] = {}

        def source(v: Any, axis: int | None) -> Any:
            """What stands for an operand: a number, a result, or what has this axis."""
            if isinstance(v, Literal) or v in made:
                return v
            if (v, axis) not in names:
                repeated, copy = self._copies.get(v, (None, None))
                names[v, axis] = copy is None or copy.results != [axis]
                if copy is not None and not names[v, axis]:
                    steps.append((copy, [source(repeated, None)], [(v, axis)]))
            return (v, axis)

        for eqn in eqns:
            member = self.members[id(eqn)]
            operands = [source(v, a) for v, a in zip(eqn.invars, member.operands, strict=True)]
            steps.append((member, operands, list(eqn.outvars)))
        inputs = [name for name, is_input in names.items() if is_input]
        results = axes_of(outputs, self._axis)

        def run(*values: Any) -> list[Any]:
            with_axis = (v if a is None else jnp.expand_dims(v, a) for (_, a), v in zip(inputs, values, strict=True))
            env: dict[Any, Any] = dict(zip(inputs, with_axis, strict=True))
            for member, operands, targets in steps:
                env.update(zip(targets, member.run(*(value_of(v, env) for v in operands)), strict=True))
            return [env[v] if a is None else jnp.squeeze(env[v], a) for v, a in zip(outputs, results, strict=True)]

        return MemberFunction(inputs, results, run)


class MemberFunction(NamedTuple):
    """A function of one member of a batch.

    Attributes:
        inputs: variables, with the axes of the batch; None: all members share it.
        results: the axes of the batch in the results; None: all members have the same.
        run: from the values of the inputs of one member to its results.
    """

    inputs: list[tuple[Any, int | None]]
    results: Axes
    run: Callable[..., list[Any]]
