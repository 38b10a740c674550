"""Double precision, for the modules that import the fixture."""

from collections.abc import Iterator

import jax
import pytest


@pytest.fixture(autouse=True)
def float64() -> Iterator[None]:
    """Compute in float64, as a fit does."""
    with jax.enable_x64(True):
        yield
