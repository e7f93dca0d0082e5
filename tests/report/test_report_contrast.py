"""The page of ``tissueid compare``: its words, and what a browser draws of it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rendered_tissues import PAPER_A
from report_pages import drawn, grave, self_contained, wait_for_figures, wide
from typed_call import typed_call

from tissueid.contrast.decision import Compared, contrast_document
from tissueid.model.channels import ChannelModel
from tissueid.report.contrast_page import contrast_verdict, render_contrast
from tissueid.store.files import plain_json

contrast_verdict = typed_call(contrast_verdict)
render_contrast = typed_call(render_contrast)


def tissue(name: str, scale: float, *, sd: float = 0.01) -> Compared:
    chance = np.random.default_rng(len(name))
    theta = PAPER_A.theta * np.array([scale, scale, scale, scale, 1.0])
    draws = theta * np.exp(sd * chance.standard_normal((300, 5)))
    model = PAPER_A.model
    assert isinstance(model, ChannelModel)
    return Compared(name, model, draws, (PAPER_A.speeds_mm_s[0], PAPER_A.speeds_mm_s[1]), total=False)


def compared(*tissues: Compared) -> dict[str, Any]:
    return plain_json(contrast_document(tissues, clamp_N=5.0))


def test_the_page_asks_the_network_for_nothing_and_says_its_numbers():
    document = compared(tissue("kidney", 1.0), tissue("liver", 1.5))
    words = self_contained(partial(render_contrast, document)).partition("<script>")[0]
    assert "kidney and liver differ." in words
    assert "A hand could tell by the force" in words
    for limit in ("10.1068/p180681", "10.1007/BF00228884", "10.1007/BF00230304"):
        assert limit in words
    for row in document["pairs"][0]["numbers"]:
        assert row["name"] in words


def test_equal_tissues_are_not_called_equal():
    words = contrast_verdict(compared(tissue("kidney", 1.0), tissue("kidnez", 1.0)))
    assert "not shown to differ" in words.title
    assert "no proof of being equal" in words.text
    assert "a hand would hardly tell" in words.text


def test_several_pairs_are_counted_against_chance():
    document = compared(tissue("a", 1.0), tissue("bb", 1.0), tissue("ccc", 1.5))
    words = contrast_verdict(document)
    assert words.text.startswith(
        "2 of 3 pairs differ at the 2 % level; of tissues that are all one, 0.06 would"
    )
    page = render_contrast(document)
    for pair in range(1, 4):
        assert f'href="#pair-{pair}"' in page
    assert (
        "None shown"
        in contrast_verdict(compared(tissue("a", 1.0), tissue("bb", 1.0), tissue("c", 1.0))).title
    )


def test_a_name_is_text():
    wild = replace(tissue("x", 1.0), name="<script>alert(1)</script>")
    page = render_contrast(compared(wild, tissue("liver", 1.5)))
    assert "<script>alert" not in page


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (800, "dark"), (400, "light")])
def test_a_browser_draws_the_document(opened, width, scheme):
    document = compared(tissue("kidney", 1.0), tissue("liver", 1.5))
    tab = opened(render_contrast(document), width=width, height=4000, color_scheme=scheme)
    wait_for_figures(tab, 3)
    traces = {kind: drawn(tab, kind) for kind in ("loading", "hold", "ratio")}
    assert wide(tab) <= width
    assert grave(tab) == []
    if width == 1400:
        tab.emulate_media(media="print")
        assert tab.pdf()[:5] == b"%PDF-"
    rows = [(one, curve) for one in document["curves"] for curve in one["loading"]]
    assert len(traces["loading"]) == 3 * len(rows)
    for place, (one, curve) in enumerate(rows):
        for offset, kind in enumerate(("low", "high", "median")):
            trace = traces["loading"][3 * place + offset]
            assert trace["name"].startswith(one["name"])
            assert trace["x"] == curve["depth_mm"]
            assert trace["y"] == curve[kind]
    for place, one in enumerate(document["curves"]):
        trace = traces["hold"][3 * place + 2]
        assert trace["x"] == one["hold"]["time_s"][1:]
        assert trace["y"] == one["hold"]["median"][1:]
    ratios = {row["name"]: row["ratio"][1] for row in document["pairs"][0]["numbers"]}
    assert dict(zip(traces["ratio"][0]["y"], traces["ratio"][0]["x"], strict=True)) == ratios


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_gallery_can_be_read_by_everybody(browser, scheme):
    path = Path(__file__).resolve().parents[2] / "reports" / "gallery" / "index.html"
    page = browser.new_page(viewport={"width": 400, "height": 800}, color_scheme=scheme)
    page.goto(path.as_uri())
    assert grave(page) == []
    assert wide(page) <= 400
    page.close()
