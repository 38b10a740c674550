"""No NaN and no infinity in the image of any scene, nor in its derivatives, forward and reverse, float64 and float32.

Structures of support/random_scenes.py in float32; all of them, in float64, and ten times as many scenes, slow.
"""

import jax
import pytest
from random_scenes import STRUCTURES, check_batch, compiled, not_compiled

# of which other structures have the parts, one by one
LARGE = (
    "overlapping_glass_boxes",
    "panes_and_every_light",
    "relief_behind_glass",
    "glass_ball_before_a_chequer",
    "glass_box_before_a_chequer",
)


@pytest.mark.parametrize(
    "structure",
    [pytest.param(of, marks=[pytest.mark.slow] * (of.__name__ in LARGE), id=of.__name__) for of in STRUCTURES],
)
@pytest.mark.parametrize("x64", [pytest.param(True, marks=pytest.mark.slow), False])
def test_images_and_derivatives_are_finite(structure, x64):
    with jax.enable_x64(x64):
        check_batch(not_compiled, structure, 0)


@pytest.mark.slow
@pytest.mark.parametrize("structure", STRUCTURES, ids=lambda of: of.__name__)
@pytest.mark.parametrize("x64", [True, False])
def test_images_and_derivatives_of_two_thousand_scenes_are_finite(structure, x64):
    with jax.enable_x64(x64):
        for batch in range(10):
            check_batch(compiled, structure, batch)
