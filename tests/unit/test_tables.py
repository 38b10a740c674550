"""Tables: the text and the JSON that results are shown as."""

import dataclasses
import json
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pytest

from diffshade.core.tables import as_json, as_text, cells, parameters, rounded, with_error


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (0.0499944, 2.1e-5, "0.049994"),
        (2.1e-5, 2.1e-5, "0.000021"),
        (0.4, 0.012, "0.400"),
        (0.0, 0.012, "0.000"),
        (-1e-5, 0.012, "0.000"),
        (610.3, 25.0, "610"),
        (1234.5, 120.0, "1234"),
        (120.0, 120.0, "120"),
        (3.04, 3.04, "3.0"),
        (1.2345e-6, 4.5e-8, "1.234e-06"),
        (4.5e-8, 4.5e-8, "4.5e-08"),
        (0.123456789, 3e-12, "0.123457"),
        (0.0, 3e-12, "0"),
        (0.123456789, 0.0, "0.123457"),
        (0.123456789, np.inf, "0.123457"),
        (np.inf, 1.0, "-"),
        (np.nan, np.nan, "-"),
    ],
)
def test_a_number_has_the_digits_of_its_error(value, error, shown):
    assert rounded(value, error) == shown
    assert rounded(np.float64(value), np.float64(error)) == shown


def test_what_is_rounded_is_within_a_twentieth_of_its_error():
    random = np.random.default_rng(0)
    values, errors = random.choice([-1, 1], 500) * 10 ** random.uniform(-8, 5, 500), 10 ** random.uniform(-8, 1, 500)
    errors = np.maximum(errors, 1e-4 * np.abs(values))  # six digits hold them
    shown = np.array([float(text) for text in cells(values, errors)])
    assert np.all(np.abs(shown - values) <= 0.0501 * errors)


def test_a_number_beside_its_error():
    assert with_error(1.5803, 0.058) == "1.580 +- 0.058"


def test_what_is_not_determined_has_no_number():
    columns = parameters(["k_d", "n_s"], np.array([0.5, 30.0]), np.array([0.01, np.inf]), np.array([True, False]))
    assert columns == {"parameter": ["k_d", "n_s"], "value": ["0.500", "not determined"], "error": ["0.010", ""]}


def test_columns_are_aligned_and_vectors_fill_several():
    lights = np.array([[0.6, 0.0, 0.8], [-0.8, 0.0, 0.6]])
    table = {"light": ["a", "left lamp"], "x y z": lights, "place": lights.round(), "pixels": np.array([1234, 5])}
    assert as_text("Two lights", table, "That is all.", notes=["none is near."]).splitlines() == [
        "Two lights",
        "light         x  y    z  place        pixels",
        "a           0.6  0  0.8      1  0  1   1,234",
        "left lamp  -0.8  0  0.6     -1  0  1       5",
        "That is all.",
        "- none is near.",
    ]


def test_a_table_may_be_empty():
    assert as_text("No maps", {}) == "No maps"


class Place(NamedTuple):
    row: int
    name: str


@dataclass
class Result:
    numbers: np.ndarray
    place: Place
    scene: object = field(repr=False)
    more: tuple = ()


def test_every_field_is_in_the_json_but_those_that_are_not_shown():
    result = Result(np.array([[1.5, np.nan], [np.inf, 2.0]]), Place(3, "rim"), object(), ({"all": np.True_}, None, 2))
    expected = {"numbers": [[1.5, None], [None, 2.0]], "place": {"row": 3, "name": "rim"}}
    assert as_json(result) == expected | {"more": [{"all": True}, None, 2]}
    assert as_json({"results": [dataclasses.replace(result, more=())]})["results"][0] == expected | {"more": []}
    json.dumps(as_json(result), allow_nan=False)
