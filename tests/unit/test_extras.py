"""A package that is missing is named with the extra that brings it."""

import re

import pytest

from diffshade.core.extras import needing


def test_a_missing_package_is_named_with_its_extra():
    message = "cannot read a.x without the package no-such-package. Install it: pip install 'diffshade[mesh]'."
    with pytest.raises(ImportError, match=f"^{re.escape(message)}$"), needing("mesh", "cannot read a.x"):
        import no_such_package  # noqa: F401  # pyright: ignore[reportMissingImports]


def test_other_errors_pass():
    with pytest.raises(ValueError, match=r"^x$"), needing("mesh", "cannot read a.x"):
        raise ValueError("x")
