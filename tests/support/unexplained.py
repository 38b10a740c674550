"""Fits of models that are wrong on purpose, for tests that do not ask what their residuals show."""

from collections.abc import Iterator

import pytest

from diffshade.inverse import fitting


@pytest.fixture
def unexplained() -> Iterator[None]:
    """Leave out the search for the faults that residuals show, which takes a fit seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, "allow_for_faults", lambda fit, *_, **__: fit)
        yield
