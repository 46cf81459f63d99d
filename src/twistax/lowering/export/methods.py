"""What a compiled system can be written as: the methods of `Dynamics` that do so."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .c99 import CFiles, write_c
from .casadi_function import to_casadi
from .saved import save

__all__ = ["Exports"]


class Exports:
    """Base of `Dynamics`: C99, CasADi, files."""

    def to_c(
        self,
        directory: str | Path,
        *,
        name: str = "dynamics",
        dtype: Any = np.float64,
        jacobian: Sequence[str] = ("x", "u"),
        checked: bool = False,
        points: Sequence[Sequence[Any]] | None = None,
        tolerance: float | None = None,
    ) -> CFiles:
        """Write C99 code: `name.h`, which tells the call convention, `name.c`, and `name_test.c` with reference values.

        The rates, and the outputs and constraints where there are any, are functions `name_rates`, `name_outputs`,
        `name_constraints`; `name_jacobian` gives the derivatives of the rates as `jacobian` does. They allocate nothing
        and need libm only. Files of those names that an earlier call wrote are replaced.

        Args:
            directory: where to; made if it is not there.
            name: of the files, and what the names of all functions begin with.
            dtype: float64 or float32, the numbers of the code, whatever JAX's x64 switch says.
            jacobian: which of "x", "u", "params" to differentiate by; () for no derivatives.
            checked: keep 0 x, 0 / x and x - x in the values, as `tx.XLA(checked=True)` does.
            points: where the test main compares: (t, x, u, params) each; drawn at random if left out.
            tolerance: of that comparison, relative to the largest entry of a function; 1e-10, or 1e-4 for float32.
        Returns:
            The paths: `header`, `source`, `test`.
        Raises:
            ModelError: a part has no form in scalars, or two names become one in C.
            InputError: a name or type that C has not; the directory cannot be written to, or holds other files of
                those names.
        """
        return write_c(
            self,
            directory,
            name=name,
            dtype=dtype,
            jacobian=jacobian,
            checked=checked,
            points=points,
            tolerance=tolerance,
        )

    def to_casadi(
        self, families: str | Sequence[str] = "rates", *, name: str = "dynamics", checked: bool = False
    ) -> Any:
        """A `casadi.Function` in SX: t, then states, controls and parameters by name -> `rate_` and the state's name.

        Vectors are columns, matrices stay matrices, arrays of more axes are a column of their entries row by row; what
        is structurally zero is so for CasADi too. Arguments that a call leaves out are not-a-number, except a scalar
        parameter with a value of its own; bake the others to have them inside. The same holds for `jacobian()` of the
        function; others that CasADi derives, by `factory` or twice, take zero. CasADi differentiates by entries: of a
        pose by its 16, not by tangents. Its max and min do not pass not-a-number on.

        Args:
            families: one or more of "rates", "outputs", "constraints"; results of the latter two are called as in
                the system, and "inequality" and "equality".
            name: of the function.
            checked: keep 0 x, 0 / x and x - x, as `tx.XLA(checked=True)` does.
        Raises:
            ModelError: CasADi is not installed (extra `twistax[casadi]`); a part has no form in scalars; two arrays of
                one name.
            InputError: a name that CasADi does not allow.
        """
        return to_casadi(self, families, name, checked)

    def save(self, path: str | Path) -> None:
        """Write the system to a file, from which `tx.load` gives it back, compiled as it was.

        Saved are the expressions, the leaves with their bounds, guesses and values, and the options of `tx.compile`.

        Raises:
            ModelError: a node has a field that is no number, text, array or value of twistax.
            InputError: the file cannot be written.
        """
        save(self, path)
