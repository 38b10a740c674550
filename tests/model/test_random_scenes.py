"""No NaN and no infinity in the image of any scene, nor in its derivatives, forward and reverse, float64 and float32.

Some structures of support/random_scenes.py by default, the others thorough, and ten times as many scenes slow.
"""

import jax
import pytest
from random_scenes import (
    STRUCTURES,
    check_batch,
    compiled,
    not_compiled,
    sphere_under_spots,
)

QUICK = {(False, sphere_under_spots)}
CASES = [
    pytest.param(x64, structure, id=f"{structure.__name__}-float{64 if x64 else 32}", marks=marks)
    for x64 in (True, False)
    for structure in STRUCTURES
    for marks in [() if (x64, structure) in QUICK else pytest.mark.thorough]
]


@pytest.mark.parametrize(("x64", "structure"), CASES)
def test_images_and_derivatives_are_finite(x64, structure):
    with jax.enable_x64(x64):
        check_batch(not_compiled, structure, 0)


@pytest.mark.slow
@pytest.mark.parametrize("structure", STRUCTURES, ids=lambda of: of.__name__)
@pytest.mark.parametrize("x64", [True, False])
def test_images_and_derivatives_of_two_thousand_scenes_are_finite(structure, x64):
    with jax.enable_x64(x64):
        for batch in range(10):
            check_batch(compiled, structure, batch)
