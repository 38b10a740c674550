"""Derivatives of the whole model, and the table of what is differentiable, tests/support/DERIVATIVES.md."""

import pytest
from derivatives import (
    EQUATIONS,
    JUMPS,
    PLACES,
    SCENES,
    TABLE,
    check_place,
    committed_orders,
    errors_in,
    numeric_fields,
    table,
    worst_errors,
)


@pytest.mark.parametrize("name", SCENES)
def test_every_number_has_the_derivative_of_finite_differences(name):
    claimed = committed_orders()
    for field, error in worst_errors({name: errors_in(name)}).items():
        order = claimed[field]
        # ten times the claim: another machine rounds otherwise
        assert error is None or (order is not None and error <= 10.0 ** (order + 1)), f"{field}: {error}, not 1e{order}"


def test_only_jumps_have_no_derivative_and_errors_are_small():
    claimed = committed_orders()
    assert {field for field, order in claimed.items() if order is None} == JUMPS
    assert max(order for order in claimed.values() if order is not None) <= -6


@pytest.mark.parametrize("name", PLACES)
def test_finite_at_the_kink_and_0_on_the_documented_side(name):
    check_place(name)


def test_every_numeric_field_has_a_row():
    assert set(committed_orders()) == set(numeric_fields())
    assert {f"{kind}.{name}" for kind, names in EQUATIONS.items() for name in names} == set(numeric_fields())


def test_the_table_is_that_of_the_checks():
    assert TABLE.read_text(encoding="utf-8") == table(committed_orders()), "run python tests/support/derivatives.py"
