"""What stands behind a number follows from what it was computed from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest
from msgspec import structs

from tissueid.documents.reproduction import Item
from tissueid.errors import UsageError
from tissueid.reproduce import published, recordings
from tissueid.reproduce.controller import table_3
from tissueid.reproduce.hip import guidance_forces
from tissueid.reproduce.published import (
    OVERLAPS,
    PUBLISHED,
    READINGS,
    SADEGHNEJAD,
    WITHIN_INTERVAL,
    Kind,
    Ledger,
    Published,
    Readings,
    near,
    readings_from,
    rounded,
)
from tissueid.reproduce.recordings import Effort, identified_table, relaxation_tests
from tissueid.reproduce.speeds import force_displacement, peak_against_speed

QUICK = Effort(draws=0)
#: A printed number that is put in comes back changed by as much as it was changed; nothing else follows it.
CHANGE, FOLLOWS = 1.02, 0.5


def test_what_stands_behind_a_row_follows_from_what_its_ledger_handed_out():
    ledger = Ledger(SADEGHNEJAD, "Table 1")
    value = ledger.printed("table-2/tau")
    assert ledger.item("table-2/tau", value).kind is Kind.ROUND_TRIP
    assert ledger.item("beside", value, against="table-2/tau").kind is Kind.ROUND_TRIP
    assert ledger.item("table-2/stiffness", value).kind is Kind.REPRODUCED
    ledger.assume("a mass", 2.0)
    assert ledger.item("table-2/stiffness", value).kind is Kind.ASSUMED
    assert ledger.item("table-2/tau", value).kind is Kind.ROUND_TRIP
    assert ledger.item("table-2/tau", None).kind is Kind.NOT_REPRODUCIBLE
    ledger = Ledger(SADEGHNEJAD, "Table 1")
    ledger.read("a reading")
    other = ledger.branch()
    other.printed("table-2/tau")
    assert ledger.item("table-2/tau", 1.0).kind is Kind.REPRODUCED
    assert other.item("table-2/tau", 1.0).kind is Kind.ROUND_TRIP
    assert other.item("table-2/tau", 1.0).reading == "a reading"
    with pytest.raises(TypeError, match="range"):
        ledger.printed("figure-5/nrmsd")
    ledger = Ledger(SADEGHNEJAD, "Table 1")
    assert ledger.item("figure-9/new", 1.0).kind is Kind.RECOMPUTED
    assert ledger.item("new", 1.0, against="table-2/tau").kind is Kind.REPRODUCED
    given = ledger.given("table-3/1", "Mass of the operator [kg]", "put in")
    assert (given.kind, given.published, given.recomputed) == (Kind.GIVEN, 1.25, None)
    for kind in (Kind.REPRODUCED, Kind.GIVEN):
        with pytest.raises(ValueError, match="no printed number"):
            Item(**structs.asdict(ledger.item("figure-9/new", 1.0)) | {"kind": kind})


@pytest.mark.parametrize(
    ("judge", "published", "recomputed", "interval", "agrees"),
    [
        (near(0.5, "N"), 86.64, 87.1, None, True),
        (near(0.5, "N"), 86.64, 87.2, None, False),
        (WITHIN_INTERVAL, 0.0214, 0.0218, (0.0209, 0.0222), True),
        (WITHIN_INTERVAL, 0.0214, 0.0218, (0.0215, 0.0222), False),
        (WITHIN_INTERVAL, 0.0214, 0.0214, None, False),
        (OVERLAPS, (4.23, 10.95), (10.0, 20.0), None, True),
        (OVERLAPS, (4.23, 10.95), (11.0, 20.0), None, False),
        (rounded(3), 0.021, 0.021025, None, True),
        (rounded(3), 0.021, 0.0216, None, False),
    ],
)
def test_agreement_is_decided_by_its_rule(judge, published, recomputed, interval, agrees):
    assert judge.holds(published, recomputed, interval) is agrees


def numbers_with(key: str) -> dict[str, Published]:
    """The catalogue, one number changed."""
    entry = PUBLISHED[key]
    assert isinstance(entry.value, float)
    return {**PUBLISHED, key: replace(entry, value=CHANGE * entry.value)}


def rows(numbers: Mapping[str, Published]) -> dict[str, Item]:
    """Every row that stands beside a printed number, with little effort."""
    readings = Readings()
    with pytest.MonkeyPatch.context() as patch:
        # one test of Table 1 stands for all four
        patch.setattr(recordings, "DEPTHS_MM", (8,))
        patch.setattr(published, "PUBLISHED", numbers)
        found = relaxation_tests(readings, QUICK)[0]
        found += force_displacement(readings)[0] + peak_against_speed(readings)[0]
        found += identified_table(readings, replace(QUICK, rate_Hz=100.0))
        found += table_3(readings) + guidance_forces(readings)[0]
    return {one.item: one for one in found if one.published is not None and one.recomputed is not None}


@pytest.fixture(scope="module")
def unchanged():
    return rows(PUBLISHED)


@pytest.mark.parametrize(
    "key",
    [
        "table-1/tau-8mm",
        "table-2/stiffness",
        *(
            pytest.param(key, marks=pytest.mark.slow)
            for key in ("table-1/peak-8mm", "table-2/tau", "guidance/tau")
        ),
    ],
)
def test_a_row_that_follows_its_printed_number_is_labelled_a_round_trip(key, unchanged):
    before, after = unchanged, rows(numbers_with(key))
    followed = {
        name
        for name, row in after.items()
        if PUBLISHED[key].where == row.where
        and row.published != before[name].published
        and row.recomputed / before[name].recomputed - 1.0 > FOLLOWS * (CHANGE - 1.0)
    }
    assert key in followed
    assert {after[name].kind for name in followed} == {Kind.ROUND_TRIP}


def test_only_the_mean_of_table_1_is_reproduced_without_being_put_in():
    mean = relaxation_tests(Readings(relaxation="rate"), QUICK)[0][-2]
    assert (mean.item, mean.kind, mean.agrees) == ("table-2/mean-of-table-1", Kind.REPRODUCED, True)
    assert mean.recomputed == pytest.approx((0.0214 + 0.0212 + 0.0206 + 0.0209) / 4)


def test_readings_that_contradict_the_table_are_said_to():
    found, figure = relaxation_tests(Readings(relaxation="rate"), QUICK)
    table = [row for row in found if row.where == "Table 1"]
    assert [row.kind for row in table] == [Kind.NOT_REPRODUCIBLE] * 8
    assert {row.agrees for row in table} == {None}
    assert "contradict" in str(table[0].note)
    assert figure.kind is Kind.NOT_REPRODUCIBLE


def test_every_reading_has_a_default_and_can_be_switched():
    assert Readings().as_json().keys() == READINGS.keys()
    for name, choices in READINGS.items():
        assert getattr(Readings(), name) == next(iter(choices))
        for choice, words in choices.items():
            assert readings_from([f"{name}={choice}"]).words(name) == words


@pytest.mark.parametrize("setting", ["stiffness", "stiffness=cubic", "colour=red", "=linear"])
def test_an_unknown_reading_is_refused(setting):
    with pytest.raises(UsageError, match="--set"):
        readings_from([setting])
