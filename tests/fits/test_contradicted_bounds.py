"""Bounds that the photographs contradict: they are named before other causes, and what they hold is withdrawn."""

from functools import cache

import numpy as np
import pytest
from synthetic import forget, noisy, one_light_each, photographs, point_lights, standard_scene

import diffshade as ds

TOLD = standard_scene(ds.Material(0.1, 0.6, 0.3, 50), point_lights()[:3])
FREE = ("k_a", "k_d", "k_s", "n_s")


@cache
def images() -> list[np.ndarray]:
    return noisy(photographs(TOLD), 0.005, 1)


@pytest.mark.parametrize(("name", "bounds"), [("k_s", (0.0, 0.2)), ("n_s", (1.0, 40.0)), ("n_s", (60.0, 90.0))])
def test_a_bound_that_the_photographs_contradict_is_named_first_and_its_value_withdrawn(name, bounds):
    """Of few pixels, of which the residuals as a whole look like noise."""
    found = ds.fit(forget(TOLD), one_light_each(images()), free=FREE, bounds={name: bounds})
    at = [j for j, of in enumerate(found.names) if of.startswith(name)]
    assert found.at_bound[at].all()
    assert not found.determined[at].any()
    (note,) = (note for note in found.notes if note.kind == "cause")
    assert note.names[0] == "bound"
    assert f"the photographs want {name} beyond the bound {found.values[at[0]]:g}" in note


def test_a_bound_within_the_noise_is_no_cause():
    found = ds.fit(forget(TOLD), one_light_each(images()), free=FREE, bounds={"k_d": (0.1, 0.6)})
    assert found.at_bound.any()
    assert found.determined.all()
    assert not [note for note in found.notes if note.kind == "cause"]


@pytest.mark.thorough
def test_a_bound_that_is_a_little_off_is_named():
    exact = noisy(photographs(TOLD), 1e-4, 1)
    found = ds.fit(forget(TOLD), one_light_each(exact), free=FREE, bounds={"n_s": (1.0, 49.7)})
    (note,) = (note for note in found.notes if note.kind == "cause")
    assert "the photographs want n_s beyond the bound 49.7" in note
    assert not found.determined[found.names.index("n_s")]
