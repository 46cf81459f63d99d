"""How much LLVM optimises kernels: not at all in most tests, as for users in those of kernels and the smoke tier.

Its work on kernels took a third of what compiling a problem takes.
"""

import os

import pytest

from twistax.scalar.targets.llvm import machine_code

USERS = machine_code.LEVEL
machine_code.LEVEL = 0 if os.environ["XLA_FLAGS"] else USERS


@pytest.fixture
def optimised(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels as users have them."""
    monkeypatch.setattr(machine_code, "LEVEL", USERS)
