"""The exceptions of this package. Each message states what is wrong, what was expected, what was passed and how to mend
it.
"""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Iterator
from types import FrameType
from typing import ClassVar

#: The page that explains an input or a model that a part of the package refuses, by the beginning of its name; parts of
#: parts come first.
PAGES = {
    "twistax.view": "docs/howto/show.md",
    "twistax.plots": "docs/integrating.md#results",
    "twistax.monte_carlo": "docs/monte_carlo.md",
    "twistax.trimming": "docs/trim.md",
    "twistax.trajectory": "docs/trajectory.md",
    "twistax.estimation": "docs/estimation.md",
    "twistax.linear": "docs/trajectory.md",
    "twistax.mechanics.models.daveml": "docs/daveml.md",
    "twistax.mechanics.models": "docs/howto/mechanism_from_a_file.md",
    "twistax.mechanics.flight": "docs/flight.md",
    "twistax.mechanics.joints": "docs/joints.md",
    "twistax.mechanics.bodies": "docs/bodies.md",
    "twistax.mechanics.loops": "docs/closed_loops.md",
    "twistax.mechanics.contact": "docs/contact.md",
    "twistax.mechanics.editing": "docs/robots.md#edit-a-mechanism",
    "twistax.mechanics.writers": "docs/robots.md#write-a-file",
    "twistax.mechanics.reaching": "docs/robots.md#reach-a-pose",
    "twistax.mechanics.tasks": "docs/robots.md#control-by-tasks",
    "twistax.mechanics.control": "docs/robots.md#control-by-tasks",
    "twistax.mechanics.distances": "docs/robots.md#distances-between-solids",
    "twistax.mechanics.identification": "docs/robots.md#identify-a-mechanism",
    "twistax.mechanics": "docs/mechanics.md",
    "twistax.integrators.diffrax_bridge": "docs/for_diffrax_users.md",
    "twistax.integrators.results.table_export": "docs/integrating.md#results",
    "twistax.integrators": "docs/integrating.md",
    "twistax.groups": "docs/conventions.md",
    "twistax.scenes": "docs/scenes.md",
    "twistax.system.export": "docs/exporting.md",
    "twistax.scalar.fast": "docs/fast.md",
}
#: What serves all parts: those who call it are asked.
_EVERYWHERE = (
    "twistax.errors",
    "twistax.checks",
    "twistax.units",
    "twistax.mechanics.arguments",
    "twistax.expr.declaring",
)


class TwistaxError(Exception):
    """Base class of the errors of this package. A traceback ends with the documentation page for the error."""

    #: That page. It is a note and no part of the message.
    page: ClassVar[str] = "docs/reference/errors.md"
    #: Whether the part that raises it says more of it than its kind: then its page in `PAGES` stands in place of that.
    by_part: ClassVar[bool] = False

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)
        self.add_note(f"  see: {(self.by_part and _page_of_caller()) or self.page}")


def _page_of_caller() -> str | None:
    """The page of the part that makes an error: of the innermost frame that belongs to one."""
    frame: FrameType | None = inspect.currentframe()
    while frame is not None:
        module = frame.f_globals.get("__name__", "")
        if module.startswith("twistax.") and not module.startswith(_EVERYWHERE):
            return next((page for part, page in PAGES.items() if module.startswith(part)), None)
        frame = frame.f_back
    return None


class ShapeError(TwistaxError, ValueError):
    """Shapes do not match. The first line of the message states the mismatch. `at` adds the place in the expression
    tree, `hint` a remedy.
    """

    page = "docs/writing_a_system.md#expressions"
    by_part = True

    def __init__(self, sentence: str, *, at: str | None = None, hint: str | None = None) -> None:
        self.sentence = sentence
        self.at = at
        self.hint = hint
        lines = [sentence]
        if at:
            lines.append(f"  at: {at}")
        if hint:
            lines.append(f"  fix: {hint}")
        super().__init__("\n".join(lines))

    def located(self, at: str) -> ShapeError:
        """The same error with its place in the tree."""
        return ShapeError(self.sentence, at=at, hint=self.hint)


class ModelError(TwistaxError, ValueError):
    """A system, problem or leaf is declared inconsistently."""

    page = "docs/writing_a_system.md"
    by_part = True


class OrderError(ModelError):
    """A [v; w] quantity is combined with a [w; v] quantity without a Reorder between them."""

    page = "docs/conventions.md#the-operators-in-both-orders"
    by_part = False


class KindError(ModelError):
    """Two values that must agree in kind, frame or unit differ; the message names the operator that combines them."""

    page = "docs/kinds.md"
    by_part = False


class InputError(TwistaxError, ValueError):
    """Values passed to a call do not match the declarations."""

    page = "docs/writing_a_system.md#simulating-it"
    by_part = True


class ImmutableError(TwistaxError, AttributeError):
    """An assignment to a node. Nodes are immutable; `replace` returns a changed copy."""

    page = "docs/writing_a_system.md"


class OperationError(TwistaxError, TypeError):
    """An operator, an index, a function or an argument that expressions do not support."""

    page = "docs/writing_a_system.md#expressions"


class IntegrationError(TwistaxError, RuntimeError):
    """An integration ended before its end time. The message states the cause."""

    page = "docs/integrating.md#results"


class TrajectoryError(TwistaxError, RuntimeError):
    """A trajectory problem could not be set up or solved."""

    page = "docs/trajectory.md#stating-a-problem"


class EstimationError(TwistaxError, RuntimeError):
    """A covariance of a filter is not positive semidefinite, or its numbers are not finite. The message contains the
    time.
    """

    page = "docs/estimation.md#what-a-run-returns"


@contextlib.contextmanager
def in_phase(name: str) -> Iterator[None]:
    """Errors with the name of the phase as prefix."""
    try:
        yield
    except TwistaxError as error:
        with_phase = type(error)(f"{name}: {error}")
        with_phase.__notes__ = list(error.__notes__)
        raise with_phase from None
