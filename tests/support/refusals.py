"""How a test looks at a refusal: the error and some words of its message, not the whole sentence."""

import os
from collections.abc import Callable

import pytest

# of a test whose values have a wrong type: jaxtyping refuses them before the library can, where types are checked
untyped = pytest.mark.skipif(os.environ.get("DIFFSHADE_TEST_TYPES") == "1", reason="types are checked before.")


def refuses(make: Callable[[], object], *words: str, error: type[Exception] | tuple = ValueError) -> None:
    """Assert that a call is refused in one line that holds all the words: the name, the value, the remedy."""
    with pytest.raises(error) as refusal:
        make()
    message = str(refusal.value)
    assert "\n" not in message
    for word in words:
        assert word in message
