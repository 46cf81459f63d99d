"""The exceptions users meet. Each message says what is wrong, what was expected, what came and how to mend it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import ClassVar


class TwistaxError(Exception):
    """Base of every error raised by this package on purpose. A traceback ends with the page that explains its kind."""

    #: That page. It is a note and no part of the message.
    page: ClassVar[str] = "docs/reference/errors.md"

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)
        self.add_note(f"  see: {self.page}")


class ShapeError(TwistaxError, ValueError):
    """A shape does not fit.

    The first line is the plain sentence. `at` adds where in the tree the node stands, `hint` how to mend it.
    """

    page = "docs/writing_a_system.md#expressions"

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
        """The same error with its place in the tree filled in."""
        return ShapeError(self.sentence, at=at, hint=self.hint)


class ModelError(TwistaxError, ValueError):
    """A system, problem or leaf is declared in a way that has no meaning."""

    page = "docs/writing_a_system.md"


class OrderError(ModelError):
    """A [v; w] quantity meets a [w; v] quantity without a Reorder between them."""

    page = "docs/conventions.md#the-operators-in-both-orders"


class InputError(TwistaxError, ValueError):
    """Values given at call time do not fit what was declared."""

    page = "docs/writing_a_system.md#simulating-it"


class ImmutableError(TwistaxError, AttributeError):
    """Somebody assigned to a node. Nodes are values; `replace` makes a changed copy."""

    page = "docs/writing_a_system.md"


class OperationError(TwistaxError, TypeError):
    """An operator, an index, a function or an argument that has no meaning for expressions."""

    page = "docs/writing_a_system.md#expressions"


class IntegrationError(TwistaxError, RuntimeError):
    """An integration ended before its end time. The message names what happened."""

    page = "docs/integrating.md#results"


class TrajectoryError(TwistaxError, RuntimeError):
    """A trajectory problem could not be set up or solved."""

    page = "docs/trajectory.md#stating-a-problem"


@contextlib.contextmanager
def in_phase(name: str) -> Iterator[None]:
    """Errors with the phase's name in front."""
    try:
        yield
    except ShapeError as error:
        raise ShapeError(f"{name}: {error}") from None
    except TwistaxError as error:
        raise type(error)(f"{name}: {error}") from None
