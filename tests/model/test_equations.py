"""Every equation of the model is compared with what it should be, and is right."""

import io

import pytest
from equations import TERMS, Comparison, comparisons, table
from rich.console import Console

# What there is to compare each equation with, at least: of E7, E10 and E11 no other program's render is at hand.
EVERYTHING = {"oracle", "closed form", "OpenGL", "POV-Ray", "VTK"}
WITNESSES = {equation: {"oracle", "closed form"} for equation in TERMS} | {
    "E1": EVERYTHING,
    "E2": EVERYTHING,
    "E3": {"oracle", "closed form", "OpenGL", "POV-Ray"},
    "E4": EVERYTHING,
    "E5": {"oracle", "closed form", "POV-Ray", "VTK"},
    "E6": {"oracle", "closed form", "OpenGL", "POV-Ray"},
    "E8": {"oracle", "OpenGL", "POV-Ray", "VTK"},
    "E9": {"oracle", "closed form", "OpenGL"},
    "E12": {"oracle", "closed form", "POV-Ray"},
    "E14": {"oracle", "closed form", "OpenGL"},
}


@pytest.fixture(scope="module")
def found() -> list[Comparison]:
    return list(comparisons(every=False))


def test_there_are_fourteen():
    assert list(TERMS) == [f"E{i}" for i in range(1, 15)]


@pytest.mark.parametrize("equation", TERMS)
def test_an_equation_is_right(found, equation):
    here = [c for c in found if c.equation == equation]
    assert {c.witness for c in here} >= WITNESSES[equation]
    for c in here:
        assert c.numbers > 0
        assert c.error <= c.tolerance, f"{equation} is {c.error:.1e} from what the {c.witness} says"


def test_the_table_has_a_row_for_each_and_says_which_is_wrong(found):
    def printed(comparisons):
        text = io.StringIO()
        Console(file=text, width=132).print(table(comparisons))
        return text.getvalue()

    lines = printed(found).splitlines()
    for equation, term in TERMS.items():
        (row,) = [line for line in lines if f" {equation} " in line]
        assert term in row
        assert "yes" in row
    assert "NO" not in printed(found)
    assert "NO" in printed([*found, Comparison("E3", "oracle", 1, 1e-11, 1e-12)])
    assert "NO" in printed([*found, Comparison("E3", "oracle", 1, float("nan"), 1e-12)])


@pytest.mark.slow
def test_every_picture_is_right():
    assert not [c for c in comparisons(every=True) if not c.error <= c.tolerance]
