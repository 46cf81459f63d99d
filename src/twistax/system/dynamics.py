"""Compiled systems, as integrators, filters, optimisers and users call them."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, overload

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..checks import real_array
from ..errors import ModelError
from ..progress import watched
from ..scalar.backends import Backend, chosen
from ..scalar.targets.llvm.backend import Auto
from ..scalar.walk import uncollected
from .explain import Dependence, Explanation, KindsExplanation, explain, explain_kinds, explain_one
from .export import CFiles
from .functions import Arrays, Functions
from .hessian import hessian, hessian_pattern
from .inputs import Values
from .projection import project
from .system import System


class Dynamics:
    """The functions of a system, jitted and differentiable, all with the signature (t, x, u, params).

    x, u and params are dicts by leaf name. u and params are optional; a missing parameter has its default value. The
    result has the precision of x. Made by `compile`.

    Attributes:
        system: the original system.
        states, controls, parameters: its leaves in order, without those that `bake` made constants.
        group: the product group of the state; its `slices` have the position of each state in a tangent vector.
        dimension: length of a tangent vector.
        backend: the backend of its functions.
        baked: the values of parameters that are constants of the compiled system, by name.
        functions: the same functions of checked arguments, for integrators and other loops.
    """

    def __init__(self, functions: Functions) -> None:
        self.functions = functions
        self.system = functions.system
        self.states, self.controls, self.parameters = functions.states, functions.controls, functions.parameters
        self.group = functions.group
        self.dimension = functions.group.dimension
        self.backend = functions.backend
        self.baked = functions.baked

    def __reduce__(self) -> Any:
        return Dynamics, (self.functions,)

    def __repr__(self) -> str:
        kinds = {"states": self.states, "controls": self.controls, "parameters": self.parameters}
        groups = {name: group.name for name, group in self.group.factors.items() if not group.flat}
        named = {kind: [f"{e.name} {groups.get(e.name, e.shape)}" for e in entries] for kind, entries in kinds.items()}
        shown = [f"{kind}: {', '.join(entries)}" for kind, entries in named.items() if entries]
        return f"Dynamics({'; '.join([*shown, f'backend: {self.backend}'])})"

    def __call__(self, t: Any, x: Values, u: Values | None = None, params: Values | None = None) -> Arrays:
        """Rates by state name: a body velocity for a group-valued state.

        Raises:
            InputError: an unknown key, a wrong shape, or a missing value that is read.
        """
        return self.functions.call("rates", t, x, u, params)

    def outputs(self, t: Any, x: Values, u: Values | None = None, params: Values | None = None) -> Arrays:
        """The outputs by name. Raises the errors of a call of the dynamics."""
        return self.functions.call("outputs", t, x, u, params)

    def constraints(self, t: Any, x: Values, u: Values | None = None, params: Values | None = None) -> Arrays:
        """`{"inequality": (n,) <= 0, "equality": (m,) = 0}` in the order of declaration. Raises the errors of a
        call.
        """
        return self.functions.call("constraints", t, x, u, params)

    def jacobian(
        self,
        t: Any,
        x: Values,
        u: Values | None = None,
        params: Values | None = None,
        *,
        wrt: str | Sequence[str] = ("x", "u"),
    ) -> Arrays:
        """The derivatives of the rates: {"x": (n, n), "u": (n, m)}, without computing structural zeros.

        Rows are the rates as one tangent vector, with states in the order of declaration. Columns of "x" are right
        perturbations x (+) d; columns of "u" and "params" are the entries of the arguments in row-major order, in the
        order of declaration. Units are those of the rates over those of the columns. Traceable and differentiable.

        Args:
            wrt: one or several of "x", "u", "params", a tuple or one name.
        Raises:
            InputError: the errors of a call of the dynamics; an unknown entry in wrt.
        """
        names = tuple(wrt) if isinstance(wrt, (tuple, list)) else (wrt,)
        return self.functions.jacobian(self.functions.prepare(t, x, u, params), names)

    def hessian(
        self,
        t: Any,
        x: Values,
        u: Values | None,
        params: Values | None,
        weights: Values,
        *,
        wrt: str | Sequence[str] = ("x", "u"),
    ) -> jax.Array:
        """The second derivatives of sum_i w_i . f_i, a symmetric (N, N); f_i are rates, outputs or constraints.

        Rows and columns follow `wrt`: right perturbations x (+) d of the states, entries of controls and parameters,
        like the columns of `jacobian`. Entry (j, k) is the derivative of sum_i w_i . f_i(x (+) d, u + du, p + dp) with
        respect to the tangents j and k at zero, in exponential coordinates. With E_j the derivative along x Exp(s e_j)
        it is

            $H_jk = (E_j E_k + E_k E_j) / 2 = E_k E_j - [E_k, E_j] / 2$,

        which is symmetric: only one triangle is computed, without structural zeros. Other values of the weights do not
        recompile. Traceable, batched by vmap and differentiable. Functions without a scalar form are differentiated by
        JAX. Units are those of w . f over those of both tangents.

        Args:
            weights: by the name of a state (for its rate), of an output or of a constraint; or by "inequality" and
                "equality" for all constraints of a kind. Each has the shape of its quantity; the default is zero.
            wrt: one or several of "x", "u", "params", a tuple or one name.
        Raises:
            InputError: the errors of a call of the dynamics; an unknown entry in wrt; a weight with an unknown or
                ambiguous name, or of another shape.

        Source: the Taylor series $f(x Exp(d)) = sum_n (sum_j d_j E_j)^n f / n!$; Helgason, Differential Geometry, Lie
        Groups, and Symmetric Spaces (1978), ch. II.
        """
        names = (wrt,) if isinstance(wrt, str) else tuple(wrt)
        return hessian(self.functions, t, x, u, params, weights, names)

    def hessian_pattern(
        self, weights: str | Iterable[str], *, wrt: str | Sequence[str] = ("x", "u")
    ) -> NDArray[np.bool_]:
        """The sparsity pattern of `hessian`, (N, N), if all controls and parameters are passed.

        Args:
            weights: the names that have weights, as in `hessian`.
        Raises:
            InputError: the errors of `hessian`.
            ModelError: it takes too many scalars, or contains functions that only JAX can differentiate.
        """
        return hessian_pattern(self.functions, weights, (wrt,) if isinstance(wrt, str) else tuple(wrt))

    def project(self, t: Any, x: Values, u: Values | None = None, params: Values | None = None) -> Arrays:
        """A state near x on the manifold of the system's constraints, for example with closed loops.

        It is computed by Newton's method with the steps x (+) correction of the system's corrections. Not traceable.

        Raises:
            InputError: the errors of a call; the iteration does not converge from x.
            ModelError: the system has no corrections.
        """
        if not self.system.corrections:
            raise ModelError("project expects a system with corrections=, such as that of a mechanism with loops")
        return project(self.functions, t, x, u, params)

    def retract(self, x: Values, d: Any) -> Arrays:
        """$x (+) d = x Exp(d)$, state by state; d is a tangent vector (n,) in the order of declaration."""
        inputs = self.functions.prepare(0.0, x, reads=())
        return self.group.retract(inputs.x, jnp.asarray(real_array("retract: d", d), inputs.dtype))

    def difference(self, x: Values, y: Values) -> jax.Array:
        """The tangent vector d with retract(x, d) = y, shape (n,): $Log(x^-1 y)$."""
        inputs = self.functions.prepare(0.0, x, reads=())
        other = {name: value.astype(inputs.dtype) for name, value in self.functions.prepare(0.0, y, reads=()).x.items()}
        return self.group.difference(inputs.x, other)

    @overload
    def explain(self) -> Explanation: ...

    @overload
    def explain(self, of: str) -> Dependence: ...

    @overload
    def explain(self, *, kinds: Literal[True]) -> KindsExplanation: ...

    def explain(self, of: str | None = None, *, kinds: bool = False) -> Explanation | Dependence | KindsExplanation:
        """A report on the computation, its simplifications, and operation counts. It compiles the rates once.

        Args:
            of: a rate or an output, "V", or one entry of it, "V[3]", "speed", whose dependencies are reported instead.
            kinds: whether to report the kinds, frames and units of leaves, rates and outputs instead.
        Raises:
            InputError: no rate or output has that name, or it has no such entry.
            ModelError: the rates, or the requested quantity, take too many scalars to count.
            KindError: declared kinds or units contradict each other.
        """
        if kinds:
            return explain_kinds(self.system)
        return explain(self.functions) if of is None else explain_one(self.functions, of)

    # ---- other forms ------------------------------------------------------------------------------------------------

    def to_c(
        self,
        directory: str | Path,
        *,
        name: str = "dynamics",
        dtype: Any = np.float64,
        jacobian: Sequence[str] = ("x", "u"),
        steps: Any = None,
        checked: bool = False,
        points: Sequence[Sequence[Any]] | None = None,
        tolerance: float | None = None,
    ) -> CFiles:
        """Write C99 code: `name.h` with the interface, `name.c`, and `name_test.c` with reference values.

        The functions are `name_rates`, and if there are any outputs or constraints `name_outputs` and
        `name_constraints`; `name_jacobian` returns the derivatives of the rates, as `jacobian` does. They allocate no
        memory and need libm only. Files of these names from an earlier call are replaced.

        Args:
            directory: the folder of the files, which is created if missing.
            name: the name of the files, and the prefix of all functions.
            dtype: float64 or float32, the precision of the code, independent of JAX's x64 setting.
            jacobian: the arguments of the derivatives, of "x", "u", "params"; () for no derivatives.
            steps: an explicit integration method, such as `tx.RKMK(tx.tableaus.RK4)`. With it, there is also
                `name_step`, which computes the states $x Exp(eta)$ after a step of length h with constant controls,
                equal to those of `tx.integrate`, and `name_simulate`, which takes n steps.
            checked: whether 0 x, 0 / x and x - x are evaluated rather than simplified, as by `tx.XLA(checked=True)`.
            points: points of the test program, (t, x, u, params) each; random by default.
            tolerance: of the test program, relative to the largest entry of a function; 1e-10, or 1e-4 for float32.
        Returns:
            The paths `header`, `source` and `test`.
        Raises:
            ModelError: a part has no scalar form, such as steps of implicit methods; two names that become the same in
                C; `steps` is not a method.
            InputError: a name that is not a C identifier, or another dtype; a directory that is not writable, or that
                contains other files of these names.
        """
        from .export.c99 import write_c

        return write_c(
            self.functions,
            directory,
            name=name,
            dtype=dtype,
            jacobian=jacobian,
            step=None if steps is None else steps_of(self, steps),
            checked=checked,
            points=points,
            tolerance=tolerance,
        )

    def to_casadi(
        self, families: str | Sequence[str] = "rates", *, name: str = "dynamics", checked: bool = False
    ) -> Any:
        """A `casadi.Function` in SX: t, then states, controls and parameters by name -> `rate_` with the state's name.

        Vectors are columns, matrices remain matrices, and arrays with more axes are columns of their entries in
        row-major order. Structural zeros are sparse in CasADi, too. Results that depend on omitted arguments are NaN,
        except for a scalar parameter with a default value; use `bake` for other parameters. The same applies to
        `jacobian()` of the function. In other functions that CasADi derives, by `factory` or by differentiating twice,
        omitted arguments are zero. CasADi differentiates a pose with respect to its 16 entries, not to tangents. Its
        max and min drop NaN.

        Args:
            families: the results, of "rates", "outputs" (by name), "constraints" (results "inequality" and "equality").
            name: the name of the function.
            checked: whether 0 x, 0 / x and x - x are evaluated rather than simplified, as by `tx.XLA(checked=True)`.
        Raises:
            ModelError: CasADi is not installed (extra `casadi`); a part has no scalar form; two arrays have the same
                name.
            InputError: a name that CasADi does not allow.
        """
        from .export.casadi_function import to_casadi

        return to_casadi(self.functions, families, name, checked)

    def to_fmu(
        self,
        path: str | Path,
        x0: Values | None = None,
        u: Values | None = None,
        params: Values | None = None,
        *,
        steps: Any = None,
        dt: float = 1e-3,
        compiler: str | None = "cc",
    ) -> Path:
        """Write a functional mock-up unit, FMI 3.0: model exchange with directional derivatives, and co-simulation.

        Its variables are states, controls, parameters and outputs, named like the columns of solution tables, with the
        units that leaves declare. A pose is exchanged as position and unit quaternion (w, x, y, z), a rotation as
        quaternion.

        Args:
            path: path of the file, `name.fmu`.
            x0, u, params: start values; other variables start at their `initial`, `guess` or `value`, or else at zero.
            steps, dt: an explicit method and the longest step, s, of co-simulation; without these, only model exchange.
            compiler: a C compiler of this machine; None: the unit contains only sources.
        Returns: the path of the file.
        Raises:
            ModelError: a part has no scalar form; `steps` is not a method; a parameter has no value; the compiler does
                not exist.
            InputError: values with unknown names, of another shape, or not finite; a path that cannot be written.

        Source: Functional Mock-up Interface Specification 3.0.1 (Modelica Association, 2023).
        """
        from .fmu.archive import write_unit

        advance = None if steps is None else steps_of(self, steps)
        return write_unit(self.functions, path, x0, u, params, advance=advance, dt=dt, compiler=compiler)

    def save(self, path: str | Path) -> None:
        """Write the system to a file, from which `tx.load` restores it, compiled with the same options.

        It contains the expressions, the leaves with bounds, guesses and values, and the options of `tx.compile`.

        Raises:
            ModelError: a node has a field that is not a number, text, array or value of twistax.
            InputError: the file cannot be written.
        """
        from .export.saved import save

        save(self.functions, path)


def compile(
    system: System,
    *,
    outputs: Iterable[str] | None = None,
    bake: Mapping[str, Any] | None = None,
    backend: Backend | Literal["auto"] = "auto",
) -> Dynamics:
    """Compile a system to jitted, differentiable functions.

    Rates, outputs and constraints are separate functions, each traced at its first call.

    Args:
        outputs: names of the outputs to keep; by default all.
        bake: parameters to make constants of the compiled system, name -> value; they are no longer inputs.
        backend: the backend of the functions. `tx.XLA()` converts large functions to scalar programs; `tx.Native()`
            compiles kernels by llvmlite; `tx.JAX()` executes everything as written, on small arrays. "auto" is
            `tx.XLA()`, with native kernels for large functions and steps of explicit methods if llvmlite is installed.
    Raises: ModelError for an unknown output or parameter, or an invalid backend; ShapeError for a value in `bake`.
    Example: `tx.compile(system)(0.0, {"x": 1.0, "v": 0.0})` is the dict of rates, in the shapes of the states.
    """
    if not isinstance(system, System):
        raise ModelError(f"compile expects a tx.System, got {type(system).__name__}; for an expression use tx.lower")
    if bake is not None and not isinstance(bake, Mapping):
        raise ModelError(f"bake must be a dict from parameter names to values, got {type(bake).__name__}")
    with watched("compile"), uncollected():
        return Dynamics(Functions(system, outputs, dict(bake or {}), chosen(backend, Auto())))


def load(path: str | Path, *, backend: Backend | Literal["auto"] | None = None) -> Dynamics:
    """Load a compiled system from a file that `Dynamics.save` wrote.

    Its expressions have the same keys as before, and on the same machine its functions return exactly the same numbers.
    Nothing in a file is executed. Custom nodes, groups and backends are found by the names of their module and class:
    import their modules first.

    Args:
        backend: a backend in place of that of the file.
    Raises:
        InputError: the file does not exist, has another type or format, or is damaged; the message names the path and
            the versions.
        ModelError: a class that is unknown, or that has changed since the file was written.
    """
    from .export.saved import read

    system, options = read(path)
    return compile(system, **(options if backend is None else {**options, "backend": backend}))


def steps_of(dynamics: Dynamics, method: Any) -> Callable[..., Arrays]:
    """A function of t, x, u, params and h that takes a step of a method. Pure and traceable.

    Raises:
        ModelError: not an integration method, or one that does not support the system.
    """
    step = getattr(method, "step_in_arrays", None)
    if isinstance(method, type) or step is None:
        raise ModelError(f"steps expects a method such as tx.RKMK(tx.tableaus.RK4), got {method!r}")
    method.check(dynamics)
    if dynamics.system.corrections:
        raise ModelError("steps: the corrections of systems with loops are not supported in C.\n  fix: leave steps out")
    return functools.partial(step, dynamics)


def need_compiled(owner: str, dynamics: object) -> None:
    """Raise ModelError where `owner` was called with anything but a compiled system."""
    if not isinstance(dynamics, Dynamics):
        raise ModelError(
            f"{owner} expects a compiled system, got {type(dynamics).__name__}.\n  fix: dynamics = tx.compile(system)"
        )
