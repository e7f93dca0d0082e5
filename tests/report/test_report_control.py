"""The page of ``tissueid control``."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tissueid.rendering.control import ControlSettings, Gains, VirtualTool, simulate
from tissueid.rendering.control.document import as_document, series_of
from tissueid.rendering.presets import preset_tissue
from tissueid.report.control_page import control_remarks, render_control

pytestmark = pytest.mark.needs_jit

SETTINGS = ControlSettings(preset_tissue("paper-a"), stiffness_scale=100.0, seconds=2.0)


def said(
    settings: ControlSettings = SETTINGS, *, frozen_first: bool = False
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Document and curves of two loops."""
    runs = {"adaptive": simulate(settings), "frozen": simulate(settings.frozen())}
    if frozen_first:
        runs = dict(reversed(runs.items()))
    return as_document(runs, source="preset paper-a"), {name: series_of(run) for name, run in runs.items()}


def test_the_page_asks_the_network_for_nothing_and_says_its_numbers() -> None:
    document, series = said()
    page = render_control(document, series, created="2026-01-01")

    assert re.findall(r'(?:src|href)="(?!data:|#)', page.partition("<script>")[0]) == []
    assert "Bounded." in page
    assert "adaptation changes next to nothing here" in page
    assert f"{document['runs'][0]['measures']['error_rms_mm']:.2e}"[:3] in page
    assert "Written 2026-01-01." in page


def test_what_a_reader_must_not_miss_is_said() -> None:
    light = replace(SETTINGS, tool=VirtualTool(0.5))
    impedance = replace(SETTINGS, environment="impedance", stiffness_scale=0.02).task("free-contact")

    impacts = replace(SETTINGS.task("impacts"), seconds=4.0)

    def remarks(settings: ControlSettings, *, frozen_first: bool = False) -> str:
        return " ".join(control_remarks(said(settings, frozen_first=frozen_first)[0]))

    assert "wrong estimates have no margin" in remarks(light)
    assert "wrong estimates" not in remarks(SETTINGS)
    assert "its error of position means nothing" in remarks(impedance)
    assert "where the law goes on" in remarks(impedance)
    assert "its proof knows neither sampling" in remarks(impacts)
    assert "its proof needs the adaptation" in remarks(impacts, frozen_first=True)


def test_a_loop_that_diverged_is_drawn_until_then() -> None:
    settings = replace(SETTINGS, variant="A", tool=VirtualTool(0.5), unchecked=True, gains=Gains())
    settings = replace(settings, start_estimates=settings.estimated_truth())

    document, series = said(settings)
    page = render_control(document, series)

    assert "Diverged." in page
    ended = document["runs"][0]["measures"]["diverged_s"]
    assert series["adaptive"]["position_mm"][0][-1] <= ended < 1.0


def test_thinned_curves_keep_their_peaks() -> None:
    run = simulate(replace(SETTINGS.task("impacts"), seconds=4.0))

    drawn = series_of(run)

    for name, exact in (
        ("environment_force_N", run.environment_force_N),
        ("control_force_N", run.control_force_N),
    ):
        times, values = drawn[name]
        assert len(times) == 1500
        assert np.abs(values).max() == pytest.approx(np.abs(exact).max(), rel=1e-5)


@pytest.mark.slow
@pytest.mark.browser
def test_figures_draw_themselves_without_an_error(browser: Any, tmp_path: Path) -> None:
    path = tmp_path / "control.html"
    path.write_text(render_control(*said()), encoding="utf-8")
    page = browser.new_page(viewport={"width": 1200, "height": 5000})
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
    page.goto(path.as_uri())
    page.wait_for_function("document.querySelectorAll('[data-drawn]').length === 10", timeout=60_000)
    lines = page.evaluate("document.querySelectorAll('.scatterlayer .trace').length")
    wide = page.evaluate("document.documentElement.scrollWidth")
    page.close()

    assert problems == []
    # two loops: two curves in three figures, one in seven; the truth in three
    assert lines == 2 * (2 * 3 + 7) + 3
    assert wide <= 1200
