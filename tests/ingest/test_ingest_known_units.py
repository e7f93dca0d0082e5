"""Units that are known without pint are what pint makes of them."""

from __future__ import annotations

import pint
import pytest

from tissueid.ingest.columns import split_name
from tissueid.units import INTERNAL_UNITS, KNOWN_UNITS, KNOWN_WORDS, REPEATS, factor_to, quantity_of

REGISTRY = pint.UnitRegistry()


@pytest.mark.parametrize("unit", sorted(KNOWN_UNITS))
def test_known_factors_are_those_of_pint(unit):
    quantity, factor = KNOWN_UNITS[unit]
    assert factor == REGISTRY.Quantity(1, unit).to(INTERNAL_UNITS[quantity]).magnitude
    assert factor_to(f"({unit})", quantity) == factor
    assert quantity_of(unit) == quantity


def test_a_known_unit_of_something_else_is_refused():
    with pytest.raises(ValueError, match="does not measure force"):
        factor_to("mm/min", "force")


@pytest.mark.parametrize("word", sorted(KNOWN_WORDS))
def test_words_over_columns_are_no_units_of_pint(word):
    with pytest.raises(pint.UndefinedUnitError):
        REGISTRY.parse_units(word)
    assert quantity_of(word) is None


@pytest.mark.parametrize("letter", sorted(REPEATS))
def test_letters_that_number_repeats_are_no_units(letter):
    assert quantity_of(letter) is None
    assert split_name(f"Load-{letter}") == (f"Load-{letter}", None)
