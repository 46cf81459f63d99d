"""Inference of the bodies of all values of a system, starting from the leaves, with an error for contradictions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from ...errors import KindError
from ..leaves import Leaf, State
from ..node import Expr
from .bodies import Acts, Bodies, BodyClash, BodyMotion
from .declare import kind_of
from .rules import OPEN

_FIX = "add twists of A relative to B and of B relative to C, or declare the bodies that are meant by of=, relative_to="
_FIX_WRENCH = "add the wrenches on one body; what it exerts on another body is subtracted"


class BodyInference:
    """Applies `Rule.bodies` to every node once.

    Args:
        leaves: all leaves, for the names of bodies.
        place: a function that describes the location of a node.
        short: a function that returns the text of a value.
    """

    def __init__(
        self, leaves: Iterable[Leaf], place: Callable[[Expr | str], str], short: Callable[[Expr], str]
    ) -> None:
        self._place, self._short = place, short
        self._known: dict[int, Bodies] = {}
        known = [_declared_bodies(leaf) for leaf in leaves]
        names = {name for bodies in known if isinstance(bodies, BodyMotion) for name in bodies.bodies}
        #: The body that each frame is fixed to, with the place that says so.
        self._body_of: dict[str, tuple[str, str]] = {name: (name, "the body of that name") for name in names}

    def read(self, nodes: Iterable[Expr]) -> None:
        """Apply the rules of nodes, children first."""
        for node in nodes:
            if id(node) in self._known:
                continue
            if isinstance(node, Leaf):
                self._known[id(node)] = _declared_bodies(node)
                continue
            children = node.children()
            known = [self._known.get(id(child)) for child in children]
            try:
                bodies = (node.kinds or OPEN).bodies(node, known) if any(known) else None
            except BodyClash as clash:
                raise self._refused(str(clash), node, clash.values, _FIX_WRENCH) from None
            declared = _declared_bodies(node)
            self._known[id(node)] = bodies or declared
            if isinstance(bodies, BodyMotion) and isinstance(declared, BodyMotion) and not bodies.fits(declared):
                raise self._refused("a twist is declared as that of another body", node, ((node, bodies),), _FIX)
            if bodies is None:
                for child, of_child in zip(children, known, strict=True):
                    self._one_body(child, of_child)

    def read_root(self, root: Expr) -> None:
        """Check that an expression computed by the system is the twist of one body."""
        self._one_body(root, self._known.get(id(root)))

    def read_rate(self, state: State, rate: Expr) -> None:
        """The rate of a state belongs to the bodies of the state; the rate of a pose is the twist of its source frame
        relative to its target frame.
        """
        of_rate, place = self._known.get(id(rate)), f"the rate of {state.name!r}"
        if not isinstance(of_rate, BodyMotion):
            return
        self._one_body(rate, of_rate)
        of_state, kind = _declared_bodies(state), kind_of(state)
        if isinstance(of_state, BodyMotion) and not of_state.fits(of_rate):
            values = ((state, of_state), (rate, of_rate))
            raise self._refused(f"the rate of the twist {state.name!r} belongs to another body", place, values, _FIX)
        if state.group.rigid and kind is not None and of_rate.complete and len(of_rate.bodies) == 2:
            frames = kind.axes()
            (moving,), (against,) = ([name for name, n in of_rate.bodies.items() if n * s > 0] for s in (1, -1))
            pairs = ((frames[-1], moving), (frames[-2], against))
            for frame, body in (pair for pair in pairs if pair[0]):
                before, reason = self._body_of.setdefault(frame, (body, place))
                if before != body:
                    raise KindError(
                        f"the frame {frame!r} is fixed to two bodies: {before!r} and {body!r}.\n  where: {place}\n"
                        f"  at: {reason}, {frame!r} is fixed to {before!r}\n"
                        f"  and: {self._short(rate)} is a twist {of_rate}\n  fix: {_FIX}"
                    )

    def _one_body(self, value: Expr, bodies: Bodies) -> None:
        if isinstance(bodies, BodyMotion) and not bodies.of_one_body:
            raise self._refused("twists do not add up to one of a body", value, ((value, bodies),), _FIX)

    def _refused(self, sentence: str, at: Expr | str, values: Iterable[tuple[Expr, Bodies]], fix: str) -> KindError:
        lines = [f"{sentence}.", f"  where: {self._place(at)}"]
        for word, (value, bodies) in zip(("at", "and"), values, strict=False):
            what = "a wrench" if isinstance(bodies, Acts) else "a twist"
            lines.append(f"  {word}: {self._short(value)} is {what} {bodies}")
        return KindError("\n".join([*lines, f"  fix: {fix}"]))


def _declared_bodies(node: Expr) -> Bodies:
    """The bodies that a leaf or another expression declares."""
    kind = kind_of(node)
    return None if kind is None else kind.bodies()


def check_bodies(
    nodes: Iterable[Expr], roots: Mapping[str, Expr], rates: Mapping[State, Expr], inference: BodyInference
) -> None:
    """Raise KindError if the bodies of values contradict each other."""
    inference.read(nodes)
    for root in roots.values():
        inference.read_root(root)
    for state, rate in rates.items():
        inference.read_rate(state, rate)
