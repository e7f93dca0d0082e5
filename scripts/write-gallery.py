#!/usr/bin/env python3
"""Write reports/gallery/index.html: what comes out of the committed synthetic sets, as small drawings.

Nothing is sampled, so that the page is the same wherever it is made, to rounding.
"""

from __future__ import annotations

import sys
from html import escape
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(REPOSITORY))

import numpy as np  # noqa: E402

import tissueid  # noqa: E402
from tissueid.model.functionals import force_after_ramp  # noqa: E402
from tissueid.model.kelvin_voigt import kelvin_voigt  # noqa: E402
from tissueid.notebook import drawing  # noqa: E402
from tissueid.result import Identification  # noqa: E402

SETS = REPOSITORY / "datasets_synthetic"
TARGET = REPOSITORY / "reports" / "gallery" / "index.html"
STYLE = (
    "body{max-width:60rem;margin:1rem auto;padding:0 1rem;font:16px/1.5 system-ui,sans-serif}"
    "table{border-collapse:collapse;font-size:.9rem}td,th{padding:.2rem .6rem;border-bottom:1px solid #8884}"
    "td,th,code,li{overflow-wrap:anywhere}:root{color-scheme:light dark}"
)
SLOW = "Thirty logs at 10 samples a second: a relaxation time of 21 ms can't be timed, and is not given."
HEAD = (
    "<h1>What comes out</h1>\n<p>From the synthetic sets of this repository, made with a known truth, as a "
    "notebook shows them; written by <code>scripts/write-gallery.py</code>. Not a medical device.</p>\n"
)
COLOURS = ("#56b4e9", "#009e73", "#d55e00")


def named(path: Path) -> str:
    """A path as it is named in the repository."""
    return path.relative_to(REPOSITORY).as_posix()


def identified(folder: str) -> Identification:
    """The optimum of a set: one branch, constant K, no draws."""
    fit = tissueid.FitOptions(branches=1, stiffness_degree=0)
    return tissueid.identify(tissueid.read_trials(SETS / folder), options=tissueid.IdentifyOptions(fit=fit))


def speeds_drawing(found: Identification) -> str:
    """Force of an identified tissue along ramps of three speeds."""
    fit = found.specimens[0]
    model = kelvin_voigt(fit.model.branches, fit.model.stiffness_degree, fit.depth_mm)
    depth = np.linspace(0.0, fit.depth_mm, 60)
    curves = []
    for speed, colour in zip((10.0, 100.0, 500.0), COLOURS, strict=True):
        force = [force_after_ramp(model, fit.theta, float(x), speed / 60.0, 0.0) if x else 0.0 for x in depth]
        curves.append((f"{speed:.0f} mm/min", depth, np.array(force), colour))
    return drawing(curves, across="depth [mm]", up="[N]", words="Force against depth at three speeds")


def gallery_page() -> str:
    """The page."""
    held = identified("paper-a-hold-100Hz")
    slow = identified("paper-a-30-10Hz")
    (recording,) = tissueid.read_trials(SETS / "paper-a-hold-100Hz")
    ruptured = tissueid.read_trials(min((SETS / "rupture-18").glob("*.csv")))[0]
    parts = [
        ("A recording", "A ramp to 8 mm and a hold, as it was read.", recording._repr_html_()),
        ("A fit", "The same with its model. Nothing was sampled: standard errors.", held._repr_html_()),
        ("Its tissue at other speeds", "Force along ramps, by the model.", speeds_drawing(held)),
        ("An answer that is none", SLOW, slow._repr_html_()),
        ("A rupture", "The force collapses while the tool moves on.", ruptured._repr_html_()),
    ]
    body = "\n".join(f"<h2>{title}</h2>\n<p>{escape(words)}</p>\n{shown}" for title, words, shown in parts)
    body = body.replace(escape(str(SETS)), named(SETS))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>Gallery – tissueid</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head><body>\n'
        f"{HEAD}"
        f"{body}\n</body></html>\n"
    )


if __name__ == "__main__":
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(gallery_page(), encoding="utf-8")
    print(named(TARGET))
