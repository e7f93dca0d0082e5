"""The page of ``calibrate``: verdict and numbers in words, figures that draw, nothing asked of a network."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from report_pages import self_contained, wait_for_figures
from typed_call import typed_call

from tissueid.report.selfcheck_page import render_selfcheck
from tissueid.selfcheck.protocol import of_recipe
from tissueid.selfcheck.records import Record
from tissueid.selfcheck.tissue import tissue_check
from tissueid.selfcheck.verdicts import Asked, check_document
from tissueid.store.files import plain_json
from tissueid.store.schema import first_problem
from tissueid.synth import recipe

render_selfcheck = typed_call(render_selfcheck)

NAMES = ("relaxation_time_s", "viscosity_N_s_per_mm", "force_N at 4 mm, 2.9 mm/s")


def document(*, narrow: bool = False) -> dict[str, Any]:
    """A check of 100 simulations whose ranks are uniform, or pile up at both ends."""
    rng = np.random.default_rng(12)
    protocol, centre = of_recipe(recipe("paper-a-hold-100Hz"))
    ranks = rng.integers(0, 400, (100, 3))
    if narrow:
        ranks[:, 0] = np.where(rng.random(100) < 0.5, 0, 399)
    records = [
        Record(
            index=i,
            truth=dict(zip(NAMES, z, strict=True)),
            mean=dict.fromkeys(NAMES, 0.0),
            sd=dict.fromkeys(NAMES, 1.0),
            rank={name: int(value) for name, value in zip(NAMES, rank, strict=True)},
            seconds=0.5,
            detail={"acceptance": 0.6},
        )
        for i, (z, rank) in enumerate(zip(rng.standard_normal((100, 3)), ranks, strict=True))
    ]
    asked = Asked("recipe", "paper-a-hold-100Hz", "paper-a", 100, 7)
    written, _ = check_document(asked, protocol, tissue_check(protocol, centre), records)
    plain: dict[str, Any] = plain_json(written)
    assert first_problem(plain, "selfcheck") is None
    return plain


def test_page_says_that_it_is_calibrated_and_for_what():
    written = document()
    page = self_contained(partial(render_selfcheck, written))
    assert "<strong>Calibrated.</strong>" in page
    assert "for this protocol, model and noise the intervals hold what they claim" in page
    assert "the program of paper-a-hold-100Hz at 100 Hz; 1 log, 3,191 samples" in page
    assert "sampler emcee, seed 7, 0.50 s each" in page
    assert "viscosity" in page
    assert "log-normal, median 0.021, sd of ln 0.4" in page
    for one in written["parameters"]:
        for row in one["coverage"]:
            assert f">{100 * row['fraction']:.1f}<" in page


def test_page_says_which_number_is_not_calibrated_and_why():
    page = render_selfcheck(document(narrow=True))
    assert "<strong>Not calibrated.</strong>" in page
    assert "relaxation_time_s: the 95 % interval covers 0.0 % (band" in page
    assert "0.0 (outside)" in page
    assert page.count("not calibrated") == 1


@pytest.mark.browser
def test_figures_draw_themselves_without_an_error(opened):
    page = opened(render_selfcheck(document()), width=1200, height=4000)
    page.wait_for_selector(".js-plotly-plot .scatterlayer", timeout=60_000)
    wait_for_figures(page, 6)
    bars = page.evaluate("document.querySelectorAll('.barlayer .point').length")
    assert bars == 3 * 20
