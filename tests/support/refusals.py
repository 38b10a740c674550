"""How a test looks at a refusal: the error and some words of its message, not the whole sentence."""

from collections.abc import Callable

import pytest


def refuses(make: Callable[[], object], *words: str, error: type[Exception] | tuple = ValueError) -> None:
    """Assert that a call is refused in one line that holds all the words: the name, the value, the remedy."""
    with pytest.raises(error) as refusal:
        make()
    message = str(refusal.value)
    assert "\n" not in message
    for word in words:
        assert word in message
