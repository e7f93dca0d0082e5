"""The page of ``inspect --html``: what was recorded; entries are decisions, written where it is served."""

import base64
import json
import re
import threading
import tomllib
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import until
from corrected_lab import corrected
from msgspec import structs
from report_pages import drawn, payload_of, self_contained, wide
from typed_call import typed_call

from tissueid.cli.main import main
from tissueid.documents import plain, typed
from tissueid.documents.inspect import Trial as TrialDocument
from tissueid.flags import Flag
from tissueid.ingest.manifest import read_study
from tissueid.inspection import describe_segmented
from tissueid.report.inspect_decisions import UNIT_TO_WRITE, Decision, decisions, toml_value
from tissueid.report.inspect_page import MOST_DRAWN, InspectedRecording, drawn_recording, render_inspection
from tissueid.result import Refusal
from tissueid.segment import segment
from tissueid.store.schema import first_problem
from tissueid.trial import Segmentation, Source, Trial
from tissueid.viewer.page_server import PageServer

decisions = typed_call(decisions)

LARGEST_PAGE_BYTES = 10_000_000


def ramp_hold(
    path: str = "run.csv", *, samples: int = 1500, sheet: str | None = None, flags: tuple[Flag, ...] = ()
) -> Trial:  # fmt: skip
    """1 mm of air, 4 mm of ramp at 2 mm/s, a hold to 15 s; one branch of 0.5 s and 0.1 N of noise."""
    time_s = np.linspace(0.0, 15.0, samples)
    x = np.minimum(2.0 * time_s, 5.0)
    depth = np.maximum(x - 1.0, 0.0)
    branch = 20.0 * -np.expm1(-np.clip(time_s - 0.5, 0, 2) / 0.5) * np.exp(-np.maximum(time_s - 2.5, 0) / 0.5)
    force = 10.0 * depth + branch + np.random.default_rng(3).normal(0.0, 0.1, samples)
    source = Source(path=path, sheet=sheet, columns={"time": "Time", "displacement": "Ext", "force": "Load"})
    return Trial("kidney", time_s, x, force, source=source, flags=flags)


@cache
def looked() -> dict[str, Any]:
    """The document of the recording above, changed by nobody."""
    return plain(recording(ramp_hold()).document)


def recording(trial: Trial, file: str = "run.csv", divided: Segmentation | None = None) -> InspectedRecording:
    divided = divided or segment(trial)
    document = typed(plain(describe_segmented(trial, divided)), TrialDocument)
    said = decisions(document, file=file)
    return InspectedRecording(document, drawn_recording(trial, divided), said, "Read as test")


def entries(html: str) -> list[dict[str, Any]]:
    from html import unescape

    texts = re.findall(r"<textarea[^>]*>(.*?)</textarea>", html, flags=re.DOTALL)
    return [tomllib.loads(unescape(text)) for text in texts]


# --- what is drawn ----------------------------------------------------------------------------------


def unpacked(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype="<f4")


def test_a_small_recording_is_carried_sample_by_sample():
    trial = ramp_hold()
    (packed,) = payload_of(render_inspection([recording(trial)]), "recordings").values()
    # 32-bit floats: 24 bits of mantissa
    assert unpacked(packed["t"]) + packed["t0"] == pytest.approx(trial.time_s, rel=1e-7, abs=1e-9)
    assert unpacked(packed["x"]) == pytest.approx(trial.displacement_mm, rel=1e-7, abs=1e-9)
    assert unpacked(packed["f"]) == pytest.approx(trial.force_N, rel=1e-7, abs=1e-6)
    divided = segment(trial)
    assert packed["phases"] == [[phase.kind, phase.start, phase.stop - 1] for phase in divided.phases]
    assert packed["contact"]["x"] == divided.contact.displacement_mm


def test_a_large_recording_keeps_its_extremes_edges_and_corners():
    trial = ramp_hold(samples=90_000)
    force = trial.force_N.copy()
    force[70_001] = 500.0
    trial = Trial("kidney", trial.time_s, trial.displacement_mm, force, source=trial.source)
    divided = segment(trial)
    drawn = drawn_recording(trial, divided)
    assert drawn.time_s.size < 9_000
    kept = set(drawn.time_s.tolist())
    assert {trial.time_s[i] for i in (0, -1, 70_001, int(force.argmin()))} <= kept
    for phase, (kind, first, last) in zip(divided.phases, drawn.phases, strict=True):
        assert (phase.kind, phase.start_s, phase.end_s) == (kind, drawn.time_s[first], drawn.time_s[last])
    for corner in divided.corners:
        assert set(trial.time_s[corner.index - 6 : corner.index + 7].tolist()) <= kept


@pytest.mark.parametrize(("count", "samples"), [(1, 90_000), (40, 20_000), (300, 400)])
def test_page_stays_below_ten_megabytes(count, samples):
    shown = [
        recording(ramp_hold(f"run {i}.csv", samples=samples), f"run {i}.csv") for i in range(min(count, 4))
    ]
    html = render_inspection([shown[i % len(shown)] for i in range(count)])
    assert len(html.encode()) <= LARGEST_PAGE_BYTES
    assert len(payload_of(html, "recordings")) == min(count, MOST_DRAWN)


# --- decisions -----------------------------------------------------------------------------------------


def study_of(entry: dict[str, Any]) -> dict[str, Any]:
    return {"schema": "tissueid/study/1", **entry}


def entry_of(document: Any, key: str) -> Decision:
    (entry,) = [one for one in decisions(document, file="run.csv") if one.key == key]
    return entry


def test_every_entry_parses_names_the_recording_and_is_valid():
    file = 'kidney "left"/run 3 [ä] \\ x.csv'
    found = decisions(looked() | {"sheet": "A"}, file=file)
    assert [one.key for one in found] == [
        "columns", "units", "compression", "force", "contact", "hold", "hold_from", "cut", "specimen",
        "exclude",
    ]  # fmt: skip
    for one in found:
        entry = tomllib.loads(one.toml)
        ((table,),) = entry.values()
        assert (table["file"], table["sheet"]) == (file, "A")
        assert first_problem(study_of(entry), "study") is None, one.toml


@pytest.mark.parametrize(
    ("sd_mm", "place", "sd"),
    [
        (4.83e-6, "0.1461059", 4.8e-6),
        (0.0123, "0.146", 0.012),
        (0.31, "0.15", 0.31),
        (4.2, "0.1", 4.2),
        # the smallest sd of an entry where the record has none: 0.1 um
        (0.0, "0.1461", 1e-4),
    ],
)
def test_the_entry_of_the_contact_point_has_the_digits_that_its_sd_has(sd_mm, place, sd):
    contact = looked()["contact"] | {"displacement_mm": 0.14610592799, "sd_mm": sd_mm}
    entry = entry_of(looked() | {"contact": contact}, "contact")
    assert f"contact_mm = {place}\n" in entry.toml
    (table,) = tomllib.loads(entry.toml)["override"]
    assert table["contact_sd_mm"] == pytest.approx(sd, rel=1e-12)  # rounding of the last bit


def test_units_that_the_file_states_are_never_prefilled_and_refused_until_written(tmp_path, capsys):
    time_s = np.linspace(0.0, 10.0, 400)
    height_m = np.minimum(time_s, 5.0) * 1e-3
    force = np.maximum(height_m - 1e-3, 0.0) * 2e3
    rows = [f"{t:.6f},{x:.9f},{f:.6f}" for t, x, f in zip(time_s, height_m, force, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["time_s,height_m,force_N", *rows, ""]), encoding="ascii")
    document = inspect(capsys, tmp_path)
    entry = entry_of(document, "units")
    manifest = tmp_path / "study.toml"
    manifest.write_text(f'schema = "tissueid/study/1"\n{entry.toml}\n', encoding="utf-8")
    assert main(["inspect", str(tmp_path), "--json"]) == 3
    assert UNIT_TO_WRITE in capsys.readouterr().err
    ((table,),) = tomllib.loads(entry.toml).values()
    assert set(table["units"].values()) == {UNIT_TO_WRITE}


def test_pasted_entries_change_the_decisions(tmp_path, capsys):
    source = (
        Path(__file__).resolve().parents[2] / "datasets_synthetic" / "paper-a-hold-100Hz" / "hold-8-1.csv"
    )
    log = tmp_path / "data" / "run 1.csv"
    log.parent.mkdir()
    log.write_bytes(source.read_bytes())
    before = inspect(capsys, log.parent)
    page = tmp_path / "page.html"
    assert main(["inspect", str(log.parent), "--html", str(page), "-q"]) == 0
    capsys.readouterr()
    changed = []
    for entry in entries(page.read_text(encoding="utf-8")):
        ((key, (table,)),) = entry.items()
        if key == "override" and "contact_mm" in table:
            table["contact_mm"] = 0.75
        if key == "override" and "units" in table:
            table["units"] = {"displacement": "mm"}
        text = "\n".join([f"[[{key}]]", *(f"{name} = {toml_value(value)}" for name, value in table.items())])
        (log.parent / "study.toml").write_text(f'schema = "tissueid/study/1"\n{text}\n', encoding="utf-8")
        after = inspect(capsys, log.parent)
        changed += [name for name in after if name != "flags" and after[name] != before[name]]
        (log.parent / "study.toml").unlink()
    assert {"compression_sign", "force_sign", "contact", "phases", "excluded"} <= set(changed)


def inspect(capsys: pytest.CaptureFixture[str], folder: Path) -> dict[str, Any]:
    assert main(["inspect", str(folder), "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert first_problem([found], "inspect") is None
    return dict(found)


def test_a_choice_of_columns_offers_the_other_one_and_a_rupture_can_be_denied():
    values = {"quantity": "displacement", "taken": "Ext", "alternatives": ["Strain 1"]}
    chosen, rupture = Flag("column_choice", "", values), {"kind": "rupture", "time_s": 2.0, "values": {}}
    document = looked() | {"flags": plain([chosen]), "events": [rupture]}
    columns, denied = (tomllib.loads(entry_of(document, key).toml) for key in ("columns", "rupture"))
    assert columns["override"][0]["columns"]["displacement"] == "Strain 1"
    assert denied["override"][0]["rupture"] is False
    assert first_problem(study_of(denied), "study") is None


def test_what_the_user_decided_is_told_with_the_reason():
    values = {"keys": ["contact_mm", "end_s", "rupture"], "because": "seen by eye"}
    decided = plain([Flag("decision_overridden", "contact_mm = 1", values)])
    told = {one.key: one.taken for one in decisions(looked() | {"flags": decided}, file="run.csv")}
    said = "as study.toml says, because: seen by eye; "
    assert {key for key, text in told.items() if text.startswith(said)} == {
        "contact", "cut", "rupture",
    }  # fmt: skip
    assert "a part of the record counts" in told["cut"]


# --- the page -------------------------------------------------------------------------------------------


@cache
def several() -> list[InspectedRecording]:
    grave = Flag("clipped_force", "the force stands at 20 N", {"force_N": 20.0})
    look = Flag("gap", "1 gap in the log", {"count": 1})
    return [
        recording(ramp_hold("good.csv")),
        recording(ramp_hold("<b>look</b>.csv", flags=(look,))),
        recording(ramp_hold("grave.csv", flags=(grave, look))),
    ]


def test_the_most_doubtful_recording_stands_first_and_what_is_excluded_is_marked():
    first, *others = several()
    shown = [replace(first, document=structs.replace(first.document, excluded="it slipped")), *others]
    html = self_contained(partial(render_inspection, shown))
    rows = re.findall(r'<tr data-row="(.*?)" data-level="(\d)"(.*?)</tr>', html, flags=re.DOTALL)
    assert [(name, level, "excluded" in row) for name, level, row in rows] == [
        ("recording-3", "3", False), ("recording-2", "2", False), ("recording-1", "0", True),
    ]  # fmt: skip


def test_names_are_escaped_flags_have_their_numbers_and_refusals_are_told_also_where_nothing_is_readable():
    refusal = Refusal("<i>x</i>.csv", None, "no_rows", "no <row>", 3, 2)
    html, nothing = render_inspection(several(), [refusal]), render_inspection([], [refusal])
    assert "<b>look</b>" not in html
    assert "<i>x</i>" not in html
    assert "<dt>force_N</dt><dd>20.00</dd>" in html
    for said in ("line 3, column 2", "no &lt;row&gt;"):
        assert said in html
        assert said in nothing
    assert "Nothing could be read" in nothing
    # the picture in words
    label, *_ = re.findall(r'data-figure="time"[^>]*aria-label="([^"]*)"', html)
    assert "1500 samples over 15.00 s, approach, ramp, hold; contact at" in label


def test_a_recording_without_any_contact_is_drawn():
    time_s = np.linspace(0.0, 10.0, 500)
    air = Trial("air", time_s, time_s * 0.1, np.random.default_rng(0).normal(0.0, 0.1, 500))
    divided = segment(air)
    if divided.contact is not None:
        divided = Segmentation(1, 1, None, divided.phases, divided.force_noise_N)
    assert "contact_mm" in render_inspection([recording(air, "air.csv", divided)])


# --- in a browser -----------------------------------------------------------------------------------------


def traces(tab: Any, kind: str, of: str = "recording-1") -> list[dict[str, Any]]:
    return drawn(tab, kind, recording=of)


@pytest.mark.browser
def test_pictures_show_the_samples_phase_by_phase_and_the_page_is_silent(opened):
    trial = ramp_hold(samples=600)
    divided = segment(trial)
    tab = opened(render_inspection([recording(trial)]))
    shown = traces(tab, "time")
    assert [one["name"] for one in shown] == 2 * ["approach", "ramp", "hold"]
    ramp = divided.of_kind("ramp")[0]
    for one, channel in ((shown[1], trial.force_N), (shown[4], trial.displacement_mm)):
        assert one["y"][:-1] == pytest.approx(channel[ramp.start : ramp.stop], rel=1e-6, abs=1e-6)
        assert one["x"][:-1] == pytest.approx(trial.time_s[ramp.start : ramp.stop], rel=1e-6, abs=1e-6)
    traces(tab, "depth")
    shapes = tab.evaluate("document.querySelector('[data-figure=depth]').layout.shapes")
    (band,) = [shape for shape in shapes if shape["type"] == "rect"]
    place, sd = divided.contact.displacement_mm, divided.contact.sd_mm
    assert (band["x0"], band["x1"]) == pytest.approx((place - sd, place + sd))


@pytest.mark.browser
def test_an_entry_is_copied_by_key_and_a_click_moves_the_contact(opened):
    tab = opened(render_inspection([recording(ramp_hold(samples=600))]),
        permissions=["clipboard-read", "clipboard-write"],
    )  # fmt: skip
    traces(tab, "depth")
    tab.evaluate(
        """() => { const box = document.querySelector('[data-figure=depth]');
                   const x = 0.1461059279;
                   box.emit('plotly_click', {points: [{x, customdata: [1, x]}]}); }"""
    )
    entry = tab.locator("#recording-1-contact")
    assert entry.is_visible()
    assert tomllib.loads(entry.input_value())["override"][0]["contact_mm"] == 0.1461059
    button = tab.locator('button[data-copies="recording-1-contact"]')
    button.focus()
    tab.keyboard.press("Enter")
    tab.wait_for_function("document.getElementById('said').textContent === 'copied'")
    assert tab.evaluate("navigator.clipboard.readText()") == entry.input_value()


@pytest.mark.browser
def test_the_index_filters_by_words_and_gravity(opened):
    tab = opened(render_inspection(several()))
    assert tab.locator("tr[data-row]:visible").count() == 3
    tab.fill("#filter-text", "GAP grave")
    assert tab.locator("tr[data-row]:visible").count() == 1
    assert tab.locator("details.specimen:visible").count() == 1
    assert tab.text_content("#recordings-shown") == "1 of 3 rows"
    tab.fill("#filter-text", "")
    tab.select_option("select[data-filters=recordings]", "2")
    assert tab.locator("tr[data-row]:visible").count() == 2
    tab.click("a[href='#recording-3']")
    assert [one["name"] for one in traces(tab, "time", "recording-3")][:3] == ["approach", "ramp", "hold"]


@pytest.mark.browser
@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (400, "dark")])
def test_page_fits_the_screen_in_both_colour_schemes(opened, width, scheme):
    html = render_inspection([*several(), recording(ramp_hold("x" * 80 + ".csv"))])
    tab = opened(html, width=width, color_scheme=scheme)
    tab.click("a[href='#recording-3']")
    traces(tab, "depth", "recording-3")
    assert wide(tab) == width


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


def click(tab: Any, figure: str, x: float, y: float) -> None:
    """A click on the sample at ``x`` that is nearest to ``y``."""
    box = f"[data-figure={figure}]"
    tab.locator(box).scroll_into_view_if_needed()
    tab.wait_for_function("box => document.querySelector(box).data", arg=box)
    tab.evaluate(
        """([box, x, y]) => {
            const shown = document.querySelector(box);
            const far = (one, i) => 1e6 * Math.abs(one.x[i] - x) + Math.abs(one.y[i] - y);
            const every = shown.data.flatMap(one => one.customdata.map((customdata, i) => (
                { x: one.x[i], customdata, far: far(one, i) })));
            const [best] = every.filter(one => one.customdata).sort((a, b) => a.far - b.far);
            shown.emit('plotly_click', { points: [best] });
        }""",
        [box, x, y],
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
