"""Scenes in a browser: the guided axis of a hip, and tissues that are no plane."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from rendered_session import Session, drag_down, heard, wait

from tissueid.haptics.states import State
from tissueid.rendering.scene import load_scene

# a page that is drawn without a graphics card takes every core there is: not beside other tests
pytestmark = [pytest.mark.browser, pytest.mark.slow]

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


def test_a_guided_wire_is_led_into_the_bone_under_its_scenes_title(chromium: Any, tmp_path: Path) -> None:
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
def test_a_tissue_that_is_no_plane_is_pressed_in(chromium: Any, tmp_path: Path, surface: str) -> None:
    with opened(chromium, tmp_path, "--preset", "paper-a", "--surface", surface) as page:
        assert page.locator("h1").text_content() == "paper-a"
        drag_down(page, 150)
        pressed = wait(page, lambda now: now["newest"]["depth_mm"] > 0.5 and now["surface"] > 0.0)
        assert pressed["newest"]["tissue_N"] > 5.0
        # what is drawn goes in by five times the tissue's depth, as the hand does
        deep = wait(page, lambda now: now["surface"] > 2.0)
        assert deep["newest"]["device_N"] > 0.1
        assert page.said == []


def test_a_twin_is_played_beside_the_recording_that_it_should_be(chromium: Any, tmp_path: Path) -> None:
    data = Path(__file__).resolve().parents[2] / "datasets_synthetic" / "paper-a-22-250Hz" / "hold-4-1.csv"
    for words in (
        ("fit", data, "--sampler", "none", "-q", "-o", tmp_path / "out"),
        ("render", tmp_path / "out" / "bundle.h5", "--twin", "--against", data, "-q"),
    ):
        subprocess.run([sys.executable, "-m", "tissueid", *map(str, words)], check=False, capture_output=True)
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
