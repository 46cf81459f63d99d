"""The expressions of a system in compiled form: with selected outputs and constant parameters, simplified."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..checks import listed
from ..errors import ModelError
from ..expr import Constant, Expr, Noise, Parameter, canonicalize_all, substitute
from ..jax_inside import is_traced


def chosen_outputs(outputs: Mapping[str, Expr], names: Iterable[str] | None) -> dict[str, Expr]:
    """The outputs with these names; all if None."""
    if names is None:
        return dict(outputs)
    names = [names] if isinstance(names, str) or not isinstance(names, Iterable) else list(names)
    for name in names:
        if name not in outputs:
            raise ModelError(f"outputs names {name!r}, which is not an output; the system has: {listed(outputs, name)}")
    return {name: outputs[name] for name in names}


def constants_of(parameters: tuple[Parameter, ...], bake: Mapping[str, Any]) -> dict[str, Constant]:
    """The parameters that `bake` makes constants: key of the leaf -> constant."""
    known = {p.name: p for p in parameters}
    constants: dict[str, Constant] = {}
    for name, value in bake.items():
        if name not in known:
            raise ModelError(f"bake names {name!r}, which is not a parameter; the system has: {listed(known, name)}")
        if value is None:
            raise ModelError(f"bake[{name!r}] is None; pass a value of shape {known[name].shape}")
        if is_traced(value):
            raise ModelError(
                f"bake[{name!r}] is traced (inside jit, grad or vmap), so its value is not known.\n"
                f"  fix: do not bake it, and pass params={{{name!r}: ...}}"
            )
        constants[known[name].key()] = Constant(known[name].replace(value=value).value)
    return constants


def silent(noises: Iterable[Noise]) -> dict[str, Constant]:
    """Zeros in place of noise: key of the leaf -> constant."""
    return {noise.key(): Constant(np.zeros(noise.shape)) for noise in noises}


def canonical(exprs: Mapping[str, Expr], constants: Mapping[str, Expr]) -> dict[str, Expr]:
    """The expressions, with constants in place of these parameters, simplified together."""
    roots = [substitute(expr, constants) for expr in exprs.values()] if constants else list(exprs.values())
    return dict(zip(exprs, canonicalize_all(roots), strict=True))
