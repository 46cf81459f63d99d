"""The exceptions users meet. Each message says what is wrong, what was expected, what came and how to mend it."""

from __future__ import annotations


class TwistaxError(Exception):
    """Base of every error raised by this package on purpose."""


class ShapeError(TwistaxError, ValueError):
    """A shape does not fit.

    The first line is the plain sentence. `at` adds where in the tree the node stands, `hint` how to mend it.
    """

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


class OrderError(ModelError):
    """A [v; w] quantity meets a [w; v] quantity without a Reorder between them."""


class InputError(TwistaxError, ValueError):
    """Values given at call time do not fit what was declared."""


class ImmutableError(TwistaxError, AttributeError):
    """Somebody assigned to a node. Nodes are values; `replace` makes a changed copy."""


class OperationError(TwistaxError, TypeError):
    """An operator, an index, a function or an argument that has no meaning for expressions."""


class IntegrationError(TwistaxError, RuntimeError):
    """An integration ended before its end time. The message names what happened."""


class TrajectoryError(TwistaxError, RuntimeError):
    """A trajectory problem could not be set up or solved."""
