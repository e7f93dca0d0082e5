"""Corrections on the served page, by hand in a browser: a click, a reason, Write; and taken back."""

from __future__ import annotations

import threading
from typing import Any

import pytest
from command_line import until
from corrected_lab import corrected

from tissueid.ingest.manifest import read_study
from tissueid.viewer.page_server import PageServer


@pytest.fixture
def page(tmp_path):
    """One recording, served."""
    with PageServer(corrected(tmp_path, "run <b>1.csv"), None) as server:
        thread = threading.Thread(target=server.run)
        thread.start()
        until(lambda: server.server.started, seconds=20.0)
        yield server
        server.server.should_exit = True
        thread.join()


def click(tab: Any, figure: str, **point: float) -> None:
    box = f"[data-figure={figure}]"
    tab.locator(box).scroll_into_view_if_needed()
    tab.wait_for_function("box => document.querySelector(box).data", arg=box)
    tab.evaluate(
        "([box, point]) => document.querySelector(box).emit('plotly_click', {points: [point]})", [box, point]
    )


def write(tab: Any, key: str, because: str) -> None:
    form = tab.locator(f"form.correct[data-key={key}]")
    form.locator("[name=because]").fill(because)
    form.get_by_role("button", name="Write").click()
    # of the page that was loaded again
    said = tab.locator(f"form.correct.stands[data-key={key}] output")
    said.filter(has_text="is written into study.toml").wait_for()


@pytest.mark.browser
def test_a_click_a_reason_and_a_button_correct_a_recording(browser, page, tmp_path):
    tab = browser.new_context(viewport={"width": 1400, "height": 900}).new_page()
    errors: list[str] = []
    tab.on("console", lambda said: errors.append(said.text) if said.type in {"error", "warning"} else None)
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto(page.url)
    # a click on the curve is the contact, at the displacement of that sample, in either picture
    click(tab, "depth", x=1.2, y=0.8)
    field = tab.locator("form.correct[data-key=contact_mm] [name=value]")
    assert float(field.input_value()) == pytest.approx(1.2)
    click(tab, "time", x=1.4, y=1.6)
    assert float(field.input_value()) == pytest.approx(1.4)
    write(tab, "contact_mm", "the film shows it")
    # a field that was entered takes the time of the click
    tab.locator("form.correct[data-key=hold_from_s] [name=value]").focus()
    click(tab, "time", x=4.5, y=9.0)
    write(tab, "hold_from_s", "the crosshead rang")
    said = read_study(tmp_path).overrides
    assert [dict(entry.values) for entry in said] == [
        {"file": "run <b>1.csv", "contact_mm": pytest.approx(1.4), "because": "the film shows it"},
        {"file": "run <b>1.csv", "hold_from_s": pytest.approx(4.5), "because": "the crosshead rang"},
    ]
    phases = tab.locator("tr", has_text="hold").locator("td").first
    assert float(phases.inner_text()) == pytest.approx(4.5)
    # a reason is asked for by the page itself, and a number out of the record is answered with its limits
    form = tab.locator("form.correct[data-key=end_s]")
    form.locator("[name=value]").fill("400")
    form.get_by_role("button", name="Write").click()
    assert form.locator("[name=because]").evaluate("field => field.matches(':invalid')")
    form.locator("[name=because]").fill("later")
    assert errors == []
    form.get_by_role("button", name="Write").click()
    tab.wait_for_function(
        "document.querySelector('form[data-key=end_s] output').textContent.includes('13.98')"
    )
    tab.locator("form.correct[data-key=contact_mm]").get_by_role("button", name="Take back").click()
    said = tab.locator("form.correct:not(.stands)[data-key=contact_mm] output")
    said.filter(has_text="is taken back").wait_for()
    assert [entry.values["because"] for entry in read_study(tmp_path).overrides] == ["the crosshead rang"]
    assert tab.locator("form.correct.stands").count() == 1
