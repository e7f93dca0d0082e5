"""A notebook shows a result: escaped text, the numbers of the result, no network."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from cohort_outputs import cohort_fits
from fit_factory import identification, specimen_fit
from posterior_factory import sampled
from rendered_tissues import PAPER_A, bundle_of

import tissueid
from tissueid.documents.identification import MisfitAlarm
from tissueid.flags import Flag
from tissueid.notebook import MOST_ROWS, drawing, table
from tissueid.trial import Axes, Trial

WILD = "<script>alert('x')</script>"


def shown(one: Any) -> tuple[str, list[str]]:
    """The page, of which every element is closed, and the texts of its cells and headings."""
    page: str = one._repr_html_()
    root = ET.fromstring(f"<div>{page}</div>")
    assert root.find(".//script") is None
    assert root.find(".//table") is not None
    assert not re.search(r"https?:|url\(|\ssrc=|\shref=", page)
    return page, ["".join(cell.itertext()) for cell in root.iter() if cell.tag in {"td", "th"}]


def a_trial(**changes: Any) -> Trial:
    time = np.linspace(0.0, 4.0, 2000)
    return Trial("liver", time, 2.0 * time, np.where(np.arange(2000) == 777, 9.0, time), **changes)


@cache
def everything() -> dict[str, Any]:
    fit = sampled(specimen_fit())
    return {
        "Identification": identification([fit]),
        "several": identification(cohort_fits(3)),
        "SpecimenFit": fit,
        "Posterior": fit.posterior,
        "Estimate": fit.parameters[0],
        "Bundle": bundle_of(PAPER_A),
        "Trial": a_trial(),
    }


@pytest.mark.parametrize("name", everything())
def test_a_result_is_shown_without_script_or_network(name: str) -> None:
    page, _ = shown(everything()[name])
    assert len(page) < 60_000


def test_a_specimen_shows_its_numbers_and_its_fit() -> None:
    fit = sampled(specimen_fit())
    page, cells = shown(fit)
    for one in fit.parameters:
        row = cells[cells.index(one.name) :][:5]
        assert row[1].startswith(f"{one.value:.4g}")
        if one.uncertainty is not None:
            low, high = one.uncertainty.ci95
            assert row[2] == f"{low:.4g} to {high:.4g}"
        assert row[4] == one.unit
    assert "measured" in page
    assert page.count("<polyline") == 2


def test_what_is_not_identified_has_no_value() -> None:
    fit = specimen_fit()
    unknown = replace(fit.parameters[0], value=None, stderr=None, identified=False)
    _, cells = shown(replace(fit, parameters=(unknown,)))
    assert cells[5:7] == [unknown.name, "not identified"]


def test_a_raised_alarm_takes_the_intervals_away() -> None:
    fit = sampled(specimen_fit())
    raised = replace(fit, posterior=replace(fit.posterior, misfit=MisfitAlarm(raised=True)))
    page, cells = shown(raised)
    assert "no interval can be believed" in page
    assert not any(" to " in cell for cell in cells)
    assert not any("±" in cell for cell in cells)
    assert "no interval can be believed" in shown(raised.posterior)[0]


def test_names_from_files_are_text() -> None:
    fit = replace(specimen_fit(), specimen=WILD, flags=(Flag("misfit", WILD),))
    for one in (
        fit,
        identification([fit, fit]),
        a_trial(flags=(Flag("gap", WILD),)),
        replace(bundle_of(PAPER_A), specimen=WILD),
    ):
        page, _ = shown(one)
        assert "<script" not in page


def test_units_follow_normalised_axes() -> None:
    _, cells = shown(replace(specimen_fit(), axes=Axes("1", "MPa")))
    assert "MPa" in cells
    assert "N/mm" not in cells
    _, cells = shown(a_trial(axes=Axes("1", "MPa")))
    assert cells[-1].endswith("MPa")


def test_a_long_recording_keeps_its_peak() -> None:
    time = np.linspace(0.0, 1.0, 100_000)
    force = np.where(np.arange(time.size) == 54_321, 7.0, 1.0)
    page = drawing([("force", time, force, "#000000")], across="time", up="N", words="a peak")
    (points,) = re.findall(r'points="([^"]+)"', page)
    heights = [float(point.split(",")[1]) for point in points.split()]
    assert len(heights) <= 800
    assert min(heights) == 24.0


def test_a_long_table_says_what_it_leaves_out() -> None:
    page = table("many", ("a",), [[str(k)] for k in range(MOST_ROWS + 7)])
    assert "and 7 more" in page
    assert table("few", ("a",), [["1"]]).count("<tr>") == 2


def test_a_study_tells_what_was_left_out(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("Time,Extension,Load\n", encoding="ascii")
    (tmp_path / "study.toml").write_text(
        'schema = "tissueid/study/1"\n[study]\ntitle = "livers"\n[[specimen]]\nname = "liver 1"\n'
        '[[exclude]]\nfile = "a.csv"\nbecause = "it slipped"\n',
        encoding="utf-8",
    )
    page, cells = shown(tissueid.read_study(tmp_path))
    assert "livers" in page
    assert "liver 1" in cells
    assert "it slipped" in cells
