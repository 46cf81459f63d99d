"""Programs of which the members of a small batch are part of one program."""

from __future__ import annotations

from ...jax_inside import weakly_kept
from ..jax_primitive import Derived


@weakly_kept
class MemberProgram(Derived):
    """A program that is traced and read once, and written out for each member of a batch in programs with that batch.

    Attributes:
        written_out: whether it is; not so other programs.
    """

    written_out = True
