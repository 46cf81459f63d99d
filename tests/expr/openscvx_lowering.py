"""Both lowerings of a case, as functions of its inputs."""

import importlib
import importlib.metadata
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from openscvx_cases import OURS, Case, Nodes

import twistax as tx

Values = Mapping[str, np.ndarray]

#: What docs/openscvx.md is about: the release, and a nightly that `pip install --pre "openscvx[lie]==..."` installs.
VERSIONS = ("0.5.2", "0.5.3.dev60")


def is_nightly() -> bool:
    """Whether it is the later of the two."""
    return importlib.metadata.version("openscvx") == VERSIONS[1]


def openscvx() -> Nodes:
    """The nodes of OpenSCvx and its lowering; the test is skipped where none of the `VERSIONS` is installed."""
    how = 'pip install "twistax[openscvx]"'
    with warnings.catch_warnings(), pytest.MonkeyPatch.context() as patch:
        warnings.simplefilter("ignore")
        pytest.importorskip("equinox")  # before OpenSCvx tells it, through the environment, to return nan for errors
        patch.setenv("EQX_ON_ERROR", "raise")
        ox = pytest.importorskip("openscvx", reason=f"OpenSCvx is not installed: {how}")
        pytest.importorskip("jaxlie", reason=f"OpenSCvx needs jaxlie for Exp and Log: {how}")
        modules = [importlib.import_module(f"openscvx.symbolic.{name}") for name in ("expr", "lower")]
    if importlib.metadata.version("openscvx") not in VERSIONS:
        pytest.skip(f"what docs/openscvx.md says is about OpenSCvx {' and '.join(VERSIONS)}")
    return Nodes(ox, ox.linalg, ox.spatial, ox.lie, *modules)


def their_leaf(nodes: Nodes, kind: str, name: str, shape: tuple[int, ...]) -> Any:
    if kind == "Parameter":
        return nodes.Parameter(name, shape=shape, value=np.zeros(shape))
    leaf = nodes.Time() if kind == "Time" else getattr(nodes, kind)(name, shape=shape)
    leaf._slice = slice(0, int(np.prod(shape)))  # the only state or control of its case
    return leaf


def theirs(nodes: Nodes, case: Case) -> Callable[[Values], Any]:
    """Their lowering of a case as a function of its inputs."""
    expr = case.build(nodes, *(their_leaf(nodes, i.kind, i.name, i.shape) for i in case.inputs))
    lowered = nodes.lower_to_jax(expr)

    def function(values: Values) -> Any:
        vectors = {i.kind: jnp.ravel(values[i.name]) for i in case.inputs}
        x, u = vectors.get("State", vectors.get("Time")), vectors.get("Control")
        return lowered(x, u, 0, {i.name: values[i.name] for i in case.inputs if i.kind == "Parameter"})

    return function


def our_leaf(kind: str, name: str, shape: tuple[int, ...]) -> tx.Expr:
    return tx.Time() if kind == "Time" else getattr(tx, kind)(name, shape=shape)


def ours(case: Case, build: Callable[..., Any]) -> Callable[[Values], Any]:
    """Our lowering of a case as a function of its inputs."""
    lowered = tx.lower(build(OURS, *(our_leaf(i.kind, i.name, i.shape) for i in case.inputs)))

    def function(values: Values) -> Any:
        by_kind: dict[str, dict[str, Any]] = {"State": {}, "Control": {}, "Parameter": {}}
        for i in case.inputs:
            if i.kind != "Time":
                by_kind[i.kind][i.name] = values[i.name]
        t = values["time"][0] if "time" in values else 0.0
        return lowered(t, by_kind["State"], by_kind["Control"], by_kind["Parameter"])

    return function
