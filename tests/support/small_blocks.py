"""Fits of texels by small blocks, for the modules that import the fixture: balls of tests have hundreds of texels."""

from collections.abc import Iterator

import pytest

from diffshade.texels import tiles
from diffshade.texels.robust import texel_work


@pytest.fixture(scope="module", autouse=True)
def small_blocks() -> Iterator[None]:
    """One program serves fits of any size, in bands or not, and hundreds of texels do not take the time of thousands.

    A texel's numbers are the same in any block.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tiles, "BLOCK", 64)
        patch.setattr(texel_work, "BLOCK", 128)
        yield
