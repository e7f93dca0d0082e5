"""Pages of fits, and tabs of a browser that show a page and hear what it says."""

import json
import re
from collections.abc import Callable
from typing import Any

import pytest
from fit_factory import identification
from typed_call import typed_call

from tissueid.documents import plain
from tissueid.report.page import render_report
from tissueid.result import SpecimenFit
from tissueid.store.curves import curves_of_fits
from tissueid.store.posteriors import posteriors_of_fits

render_report = typed_call(render_report)


def document_of(*fits: SpecimenFit, refused: bool = False) -> dict[str, Any]:
    """identification.json of these fits."""
    return plain(identification(fits, refused=refused).as_json())


def specimen_of(fit: SpecimenFit) -> dict[str, Any]:
    """A fit as one of the specimens of identification.json."""
    return plain(fit.as_json())


def payload_of(html: str, name: str) -> Any:
    (text,) = re.findall(rf'<script type="application/json" id="{name}">(.*?)</script>', html, re.DOTALL)
    return json.loads(text)


def page(*fits: SpecimenFit, refused: bool = False, **more: Any) -> str:
    document = document_of(*fits, refused=refused)
    return render_report(document, curves_of_fits(fits), posteriors_of_fits(fits), **more)


def self_contained(render: Callable[..., str]) -> str:
    """A page that asks no network; equal input gives an equal one, without a time unless it is told."""
    html = render()
    # what stands before the drawing library, whose own text holds addresses
    assert re.findall(r'(?:src|href)="(?!data:|#)', html.partition("<script>")[0]) == []
    assert html == render()
    assert "Written" not in html
    assert "Written 2026-01-01." in render(created="2026-01-01")
    return html


def open_all(tab: Any) -> None:
    tab.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")


def wait_for_figures(tab: Any, count: int) -> None:
    tab.wait_for_function(
        "count => document.querySelectorAll('[data-drawn]').length === count", arg=count, timeout=60_000
    )


def drawn(tab: Any, kind: str, **data: Any) -> list[dict[str, Any]]:
    """Traces of a figure as plotly holds them."""
    box = "".join(f'[data-{key}="{value}"]' for key, value in {"figure": kind, **data}.items())
    tab.locator(box).scroll_into_view_if_needed()
    tab.wait_for_function("box => document.querySelector(box).data", arg=box)
    return tab.evaluate(
        """box => document.querySelector(box).data.map(one => ({name: one.name, fill: one.fill,
            axis: one.xaxis || "x", x: Array.from(one.x || []), y: Array.from(one.y)}))""",
        box,
    )


def wide(tab: Any) -> int:
    return int(tab.evaluate("document.documentElement.scrollWidth"))


def grave(tab: Any) -> list[tuple[str, list[str]]]:
    """Serious and critical issues that axe-core finds: name and elements."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    found = [one for one in axe.run(tab).response["violations"] if one["impact"] in {"serious", "critical"}]
    return [(one["id"], [node["html"][:160] for node in one["nodes"]][:3]) for one in found]
