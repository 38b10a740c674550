"""The numbers on the axes of the page's drawings."""

import numpy as np
import pytest

from diffshade.report.page.charts import Frame


def numbers(ticks):
    return [float(label.replace("−", "-")) for _, label in ticks]


def test_ticks_are_round_and_within_the_axis():
    assert numbers(Frame((0.0, 90.0), (0.0, 1.0)).x_ticks()) == [0, 20, 40, 60, 80]
    assert numbers(Frame((0.0, 3.0), (0.0, 1.0)).x_ticks(whole=True)) == [0, 1, 2, 3]
    assert numbers(Frame((0.0, 1.0), (-0.02, 0.02)).y_ticks()) == [-0.02, -0.01, 0, 0.01, 0.02]
    assert [label for _, label in Frame((0.0, 1.0), (-6.0, 2.0), log=True).y_ticks()] == [
        "1e-6",
        "1e-4",
        "1e-2",
        "1e0",
        "1e2",
    ]


@pytest.mark.parametrize("seed", range(100))
def test_any_axis_has_two_to_six_ticks(seed):
    random = np.random.default_rng(seed)
    low = random.normal() * 10.0 ** random.uniform(-6, 4)
    high = low + 10.0 ** random.uniform(-5, 4)
    ticks = Frame((low, high), (low, high)).x_ticks()
    assert 2 <= len(ticks) <= 6
    assert 66 <= ticks[0][0] < ticks[-1][0] <= 328
