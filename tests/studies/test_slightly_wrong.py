"""What real set-ups have a little of: the printed errors cover, and few numbers are withheld."""

import numpy as np
import pytest
from slightly_wrong import SLIGHT, slightly_wrong
from wrong_photographs import FREE


def shares(kind: str, count: int, seeds: range) -> dict[str, tuple[float, float]]:
    """Of each parameter: how often 1.96 of its error hold the truth where it is determined, and how often it is not."""
    inside: dict[str, list[bool]] = {name: [] for name in FREE}
    withheld: dict[str, list[bool]] = {name: [] for name in FREE}
    for seed in seeds:
        fit, true = slightly_wrong(kind, count, seed)
        for name, value, error, sure, of in zip(fit.names, fit.values, fit.errors, fit.determined, true, strict=True):
            parameter = name.split(".")[0]
            withheld[parameter].append(not sure)
            if sure:
                inside[parameter].append(abs(value - of) < 1.96 * error)
    return {name: (float(np.mean(inside[name] or [1.0])), float(np.mean(withheld[name]))) for name in FREE}


@pytest.mark.parametrize("kind", ["ellipsoid", "jpeg"])
def test_errors_cover_and_little_is_withheld(kind):
    found = shares(kind, 5, range(2))
    assert np.mean([covered for covered, _ in found.values()]) >= 0.75, found
    assert np.mean([withheld for _, withheld in found.values()]) <= 0.25, found


@pytest.mark.slow
@pytest.mark.parametrize("count", [5, 12])
@pytest.mark.parametrize("kind", SLIGHT)
def test_errors_of_two_hundred_draws_cover_and_at_most_half_is_withheld(kind, count):
    found = shares(kind, count, range(200))
    print(kind, count, found)
    for name, (covered, withheld) in found.items():
        assert covered >= 0.85, name
        assert withheld <= 0.5 or kind == "together", name
