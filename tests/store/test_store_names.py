"""Names of specimens become file names that every system takes."""

from __future__ import annotations

import pytest

from tissueid.store.files import bundle_names, safe_name


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("kidney 3", "kidney_3"),
        ("a/b\\c:d*e", "a_b_c_d_e"),
        ("../../etc", "etc"),
        ("CON", "CON_"),
        ("aux.csv", "aux.csv_"),
        ("com1", "com1_"),
        ("", "specimen"),
        ("...", "specimen"),
        ("肾脏", "肾脏"),
        ("end. ", "end"),
    ],
)
def test_a_name_is_made_safe(name: str, expected: str) -> None:
    assert safe_name(name) == expected


def test_a_long_name_fits_in_eighty_bytes_and_stays_whole_characters() -> None:
    assert safe_name("é" * 300) == "é" * 40


def test_names_that_meet_without_case_are_kept_apart() -> None:
    names = bundle_names(["Liver", "liver", "a/b", "a_b", "spleen"])
    assert names["spleen"] == "bundle-spleen.h5"
    assert len({name.casefold() for name in names.values()}) == 5


def test_a_name_does_not_depend_on_the_order() -> None:
    assert bundle_names(["a b", "a_b"]) == bundle_names(["a_b", "a b"])
