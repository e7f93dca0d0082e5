"""The page in a browser: what is drawn is what the servo recorded, a mouse presses the tissue; all scenes."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import python, until
from live_server import append, record, served
from rendered_session import Session, drag_down, heard, now, wait
from session_heads import head_of

from tissueid.haptics.states import Fault, State
from tissueid.rendering.scene import load_scene
from tissueid.store.session_log import SessionLog, read_session_log

# a page that is drawn without a graphics card takes every core there is: not beside other tests
pytestmark = [pytest.mark.browser, pytest.mark.slow]

WIDTHS = ((1400, 900), (800, 1000), (400, 850))
PATIENCE_S = 60.0
#: Sessions begun until one lives through the start of a browser.
STARTS = 3
#: Digits are renewed every 60 ms; a slow picture, or a machine with other work, doubles that a few times.
OLDEST_DIGITS_TICKS = 1000


@pytest.fixture(scope="module")
def page(chromium: Any, sessions: Any) -> Iterator[Any]:
    opened = chromium.new_page(viewport={"width": 1400, "height": 900})
    opened.set_default_timeout(1e3 * PATIENCE_S)
    for _ in range(STARTS):
        opened.session = sessions()
        opened.goto(opened.session.url)
        if is_engaged(opened):
            break
    opened.said = heard(opened)
    # a page without an error from its first line on
    opened.reload()
    wait(opened, lambda now: now["drawn"] > 3 and now["newest"]["state"] == State.ENGAGED)
    yield opened
    opened.close()


def is_engaged(page: Any) -> bool:
    """True where the session lived until it may show a force."""
    deadline = time.monotonic() + PATIENCE_S
    while page.session.process.poll() is None and time.monotonic() < deadline:
        found = now(page)
        if found is not None and found["samples"] > 1500 and found["newest"]["state"] == State.ENGAGED:
            return True
        time.sleep(0.05)
    return False


def press(page: Any, pixels: int) -> Any:
    """Drag the tool down, and keep it there."""
    drag_down(page, pixels)
    return wait(page, lambda now: now["newest"]["depth_mm"] > 0.3)


def test_a_mouse_drag_presses_the_tissue_and_the_force_rises(page):
    before = now(page)
    assert before["newest"]["depth_mm"] < 0.0
    assert before["newest"]["device_N"] == 0.0
    shallow = press(page, 110)
    page.mouse.move(700, 400 + 230, steps=5)
    deep = wait(page, lambda now: now["newest"]["device_N"] > 1.3 * shallow["newest"]["device_N"])
    assert deep["newest"]["depth_mm"] > shallow["newest"]["depth_mm"]
    assert deep["newest"]["tissue_N"] > 10.0
    # the surface that is drawn went down with the tool: five times the tissue's depth
    assert wait(page, lambda now: now["surface"] > 0.0)["surface"] > 1.0
    page.mouse.up()
    # let go, the hand leaves the tissue
    assert wait(page, lambda now: now["newest"]["depth_mm"] < 0.0)["newest"]["device_N"] == 0.0


def test_keys_press_the_tissue_too(page):
    page.locator("#scene").focus()
    page.keyboard.down("ArrowDown")
    wait(page, lambda now: now["newest"]["depth_mm"] > 0.2)
    page.keyboard.up("ArrowDown")
    page.keyboard.press("Escape")
    left = wait(page, lambda now: now["newest"]["depth_mm"] < 0.0)
    assert left["newest"]["state"] == State.ENGAGED


def test_pause_marks_theme_and_cameras_answer_to_keys(page):
    page.keyboard.press("p")
    assert page.locator("#pause").get_attribute("aria-pressed") == "true"
    page.keyboard.press("p")
    page.keyboard.press("a")
    page.locator("#note-text").fill("first touch")
    page.keyboard.press("Enter")
    assert [mark["text"] for mark in wait(page, lambda now: now["marks"])["marks"]] == ["first touch"]
    before = page.locator("html").get_attribute("data-theme")
    page.keyboard.press("t")
    assert page.locator("html").get_attribute("data-theme") != before
    page.keyboard.press("t")
    with page.expect_download() as saved:
        page.locator("#save").click()
    text = Path(saved.value.path()).read_text(encoding="utf-8")
    assert "# mark at" in text
    assert "first touch" in text
    header = next(line for line in text.splitlines() if not line.startswith("#"))
    assert header.startswith("time_s,tick,dt_s,position_m.0")
    for key in "2341":
        page.keyboard.press(key)


@pytest.mark.parametrize(("width", "height"), WIDTHS)
def test_the_page_fits_its_window_and_a_screen_reader_hears_the_state(page, width, height):
    page.set_viewport_size({"width": width, "height": height})
    wait(page, lambda now: now["drawn"] > 0)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator("#status").get_attribute("aria-live") == "polite"
    until(lambda: "N at the device" in page.locator("#status").text_content())
    words = page.locator("#scale").text_content()
    assert "felt force = tissue force × 0.0127" in words
    assert "% of the depth clipped" in words


def wrong_points(traces: dict[str, Any], log: SessionLog) -> int:
    """Number of points of the traces that are no record of the servo."""
    records = log.records
    force = np.linalg.norm(records["force_N"].astype(np.float32).astype(np.float64), axis=1)
    fields = {
        "device_N": force,
        "tissue_N": records["tissue_force_N"],
        "loop_N": records["tissue_force_N"],
        "depth_mm": records["depth_mm"],
        "energy_mJ": 1e3 * records["energy_J"],
        "period_us": 1e6 * (records["dt_s"].astype(np.float32) - 1e-3),
    }
    wrong = 0
    for trace in traces.values():
        at = np.array(trace["numbers"])
        # a difference of two times of 1e5 s carries 2e-11 s
        wrong += int(np.count_nonzero(np.abs(records["time_s"][at] - trace["time_s"]) > 1e-9))
        for name, values in trace["values"].items():
            given, kept = np.array(values), fields[name][at]
            # 4 bytes carry seven digits; microseconds of a period of 1 ms four after the point
            wrong += int(
                np.count_nonzero(np.abs(given - kept) > 2e-7 * np.abs(kept) + 1e-3 * (name == "period_us"))
            )
    return wrong


def test_traces_and_digits_are_the_servos_records(page):
    session = page.session
    page.set_viewport_size({"width": 1400, "height": 900})
    press(page, 160)
    until(lambda: float(page.locator("#device-force").text_content()) >= 0.3)
    read = page.evaluate(
        """() => {
            const digits = document.getElementById("device-force");
            return {
                now: window.tissueid.read(), text: digits.textContent, tick: Number(digits.dataset.tick),
                tissue: document.getElementById("tissue-force").textContent,
                depth: document.getElementById("depth").textContent,
            };
        }"""
    )
    page.mouse.up()
    errors = list(page.said)
    page.close()
    assert session.end() in {0, 130}, session.said
    log = read_session_log(session.printed.with_name("out.h5"))
    assert set(read["now"]["traces"]) == {"force", "depth", "loop", "energy", "period"}
    assert min(len(trace["numbers"]) for trace in read["now"]["traces"].values()) > 100
    assert wrong_points(read["now"]["traces"], log) == 0
    # one corrupted value is found
    read["now"]["traces"]["force"]["values"]["device_N"][50] += 0.001
    assert wrong_points(read["now"]["traces"], log) == 1
    row = int(np.flatnonzero(log.records["tick"] == read["tick"])[0])
    record = log.records[row]
    assert read["text"] == f"{np.linalg.norm(record['force_N']):.2f}"
    assert read["tissue"] == f"{record['tissue_force_N']:.1f}"
    assert read["depth"] == f"{record['depth_mm']:.2f}"
    assert read["now"]["newest"]["tick"] - read["tick"] <= OLDEST_DIGITS_TICKS
    assert read["now"]["dropped"] == 0
    assert log.summary["lost_records"] == 0
    assert log.records["fault"].max() == Fault.NONE
    assert errors == []


def test_a_page_finds_a_session_that_was_started_again(chromium):
    page = chromium.new_page(viewport={"width": 800, "height": 700})
    with served() as first:
        page.goto(f"http://127.0.0.1:{first.access.port}/")
        shown = wait(
            page, lambda now: now["drawn"] > 0 and not now["newest"]["stale"], lambda: first.write(1)
        )
        assert shown["link"] == "live"
    assert wait(page, lambda now: now["link"] != "live")["newest"]["stale"]
    page.locator("#lamp-stale.lit").wait_for()
    assert "stale" in page.locator("body").get_attribute("class")
    assert page.locator("#link-word").text_content() in {"not connected", "connecting"}
    with served(port=first.access.port) as second:
        again = wait(page, lambda now: not now["newest"]["stale"], lambda: second.write(1, 7000))
        assert again["newest"]["tick"] == 7000
        assert again["newest"]["ageS"] < 5.0
        # as long as something comes the picture is no longer grey
        wait(page, lambda _now: not page.evaluate("document.body.className"), lambda: second.write(1, 7001))
    page.close()


def test_a_picture_that_gets_old_is_greyed_and_says_so(chromium):
    with served() as live:
        page = chromium.new_page(viewport={"width": 800, "height": 700})
        page.goto(f"http://127.0.0.1:{live.access.port}/")
        wait(page, lambda now: now["drawn"] > 0, lambda: live.write(1))
        live.write(1)
        assert wait(page, lambda now: now["newest"]["stale"])["newest"]["ageS"] > 0.5
        page.locator("#veil", has_text="stale").wait_for()
        assert "Stale" in page.locator("#lamps .lit").all_text_contents()
        page.close()


def test_a_dent_that_its_tool_has_left_goes_back_as_the_records_say(chromium):
    with served() as live:
        page = chromium.new_page(viewport={"width": 1000, "height": 800})
        page.goto(f"http://127.0.0.1:{live.access.port}/")

        def tell(depth_mm: float, surface_mm: float, force_N: float) -> None:
            one = record(0)
            one["position_m"] = (0.0, 0.0, 0.130 - 0.005 * depth_mm)
            one["depth_mm"], one["surface_mm"], one["force_N"] = depth_mm, surface_mm, (0.0, 0.0, force_N)
            # ten times what the clamp lets through
            one["tissue_force_N"] = 10.0 * force_N / head_of()["scale"]["force_scale"]
            append(live.ring, one)

        wait(page, lambda now: abs(now["surface"] - 15.0) < 1e-3, lambda: tell(3.0, 3.0, 0.5))
        page.locator("#tag-force", has_text="0.50 N on the hand").wait_for()
        shown = wait(
            page, lambda now: now["traces"].get("force", {}).get("right"), lambda: tell(3.0, 3.0, 0.5)
        )
        # the tissue's force stays within its axis where the device's was cut
        assert shown["traces"]["force"]["right"][1] >= 400.0
        for left_mm in (2.0, 0.5):
            wait(
                page,
                lambda now, at=left_mm: abs(now["surface"] - 5.0 * at) < 1e-3,
                lambda at=left_mm: tell(-1.0, at, 0.0),
            )
        assert page.locator("#tag-force").is_hidden()
        page.close()


SIM = ("--device", "sim", "--viewer", "--seconds", "200")


@contextmanager
def opened(chromium: Any, folder: Path, *asked: str) -> Iterator[Any]:
    """A page of a session, once its force is on."""
    session = Session(*asked, *SIM, folder=folder)
    page = chromium.new_page(viewport={"width": 1400, "height": 900})
    page.said = heard(page)
    try:
        page.goto(session.url, wait_until="commit")
        wait(page, lambda now: now["newest"]["state"] == State.ENGAGED)
        yield page
    finally:
        page.close()
        session.end()


def test_a_guided_wire_is_led_into_the_bone_under_its_scenes_title(chromium, tmp_path):
    with opened(chromium, tmp_path, "--scene", "hip-resurfacing") as page:
        title = load_scene("hip-resurfacing").name
        assert page.locator("h1").text_content() == title
        assert page.title().startswith(title)
        lamps = page.locator("#lamps").text_content()
        assert "Saturated" in lamps
        assert "Ruptured" not in lamps
        before = wait(page, lambda now: now["drawn"] > 3)
        # the hand begins 30 mm above the entry point
        assert before["newest"]["depth_mm"] < -20.0
        assert before["newest"]["tissue_N"] == 0.0
        drag_down(page, 210)
        touched = wait(page, lambda now: now["newest"]["tissue_N"] > 0.05)
        assert touched["newest"]["depth_mm"] > 0.0
        # under force the drill goes on by itself
        drilled = wait(page, lambda now: now["newest"]["depth_mm"] > touched["newest"]["depth_mm"] + 0.5)
        trace = drilled["traces"]["depth"]["values"]["depth_mm"]
        assert min(trace) < -20.0 < 0.0 < max(trace)
        for width in (800, 400):
            page.set_viewport_size({"width": width, "height": 900})
            assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.said == []


@pytest.mark.parametrize("surface", ["sphere 30 mm", "box 60 x 60 x 40 mm"])
def test_a_tissue_that_is_no_plane_is_pressed_in(chromium, tmp_path, surface):
    with opened(chromium, tmp_path, "--preset", "paper-a", "--surface", surface) as page:
        assert page.locator("h1").text_content() == "paper-a"
        drag_down(page, 150)
        pressed = wait(page, lambda now: now["newest"]["depth_mm"] > 0.5 and now["surface"] > 0.0)
        assert pressed["newest"]["tissue_N"] > 5.0
        # what is drawn goes in by five times the tissue's depth, as the hand does
        assert wait(page, lambda now: now["surface"] > 2.0)["newest"]["device_N"] > 0.1
        assert page.said == []


def test_a_twin_is_played_beside_the_recording_that_it_should_be(chromium, tmp_path):
    data = Path(__file__).resolve().parents[2] / "datasets_synthetic" / "paper-a-22-250Hz" / "hold-4-1.csv"
    for words in (
        ("fit", data, "--sampler", "none", "-q", "-o", tmp_path / "out"),
        ("render", tmp_path / "out" / "bundle.h5", "--twin", "--against", data, "-q"),
    ):
        python("-m", "tissueid", *words, check=False)
    printed = tmp_path / "printed.txt"
    command = ["view", tmp_path / "out" / "twin" / "felt.h5", "--beside", data, "--no-browser"]
    with printed.open("w") as out:
        viewing = subprocess.Popen([sys.executable, "-m", "tissueid", *map(str, command)], stderr=out)
    page = chromium.new_page(viewport={"width": 1400, "height": 900})
    try:
        while "://" not in printed.read_text(encoding="utf-8"):
            assert viewing.poll() is None, printed.read_text(encoding="utf-8")
            time.sleep(0.05)
        page.goto(next(word for word in printed.read_text(encoding="utf-8").split() if "://" in word))
        held = wait(page, lambda now: (now["newest"]["depth_mm"] or 0.0) > 3.99 and "force" in now["traces"])
        found = wait(page, lambda now: now["drawn"] > held["drawn"] + 60)["traces"]["force"]["values"]
        # the recording's own noise is 0.5 N
        assert abs(found["tissue_N"][-1] - found["recording_N"][-1]) < 4.0
        assert "recording" in page.locator("#strip-force figcaption").text_content()
        assert "recording" in page.locator("#strip-depth figcaption").text_content()
    finally:
        page.close()
        viewing.terminate()
        viewing.wait(20)
