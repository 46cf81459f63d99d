"""Tests of kernels see them as users have them."""

import pytest


@pytest.fixture(autouse=True)
def _as_users(optimised: None) -> None:
    """For all of them."""
