"""The page of ``tissueid compare``: whether tissues differ, by how much, and whether a hand could tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tissueid.digits import number
from tissueid.documents.contrast import Contrast, Hold, Loading, Pair
from tissueid.report.page import render_page
from tissueid.report.parts import DASHED, LOG_X, Figure, band, trace
from tissueid.report.wording import Verdict

#: A probability below this is said to be below it.
SMALL = 0.001


def contrast_verdict(document: Contrast) -> Verdict:
    """Verdict of all pairs together."""
    pairs = document.pairs
    differing = [pair for pair in pairs if pair.difference.different]
    level = f"{100 * document.level:g} %"
    if len(pairs) == 1:
        return pair_verdict(pairs[0], document.level)
    chance = f"{document.level * len(pairs):.2g}"
    text = (
        f"{len(differing)} of {len(pairs)} pairs differ at the {level} level; of tissues that are all one, "
        f"{chance} would by chance. A pair that is not shown to differ is not shown to be equal."
    )
    return Verdict("note", "Some differ" if differing else "None shown to differ", text)


def pair_verdict(pair: Pair, level: float) -> Verdict:
    """Verdict of one pair, whose tissues are called different below a level."""
    found = pair.difference
    chance = f"p {_probability(found.probability)}, level {100 * level:g} %"
    names = f"{pair.one} and {pair.other}"
    hand = f"{pair.hand[:1].upper()}{pair.hand[1:]}."
    if found.different:
        return Verdict("note", f"{names} differ", f"All forces together ({chance}). {hand}")
    equal = "That is no proof of being equal: look at the intervals of the ratios."
    return Verdict(
        "ok", f"{names} are not shown to differ", f"All forces together ({chance}). {equal} {hand}"
    )


def _probability(value: float) -> str:
    """A probability in words: the digits of a tiny one say nothing."""
    return f"below {SMALL}" if value < SMALL else f"= {number(value, 2)}"


def _banded(
    x: Sequence[float], curve: Loading | Hold, start: int, name: str, look: Mapping[str, str], unit: str
) -> list[dict[str, Any]]:
    """Band first, median on top; the group hides both together."""
    x, low, high, median = (one[start:] for one in (x, curve.low, curve.high, curve.median))
    lower, upper = band(x, (low, high), 0.25, look["ink"], legendgroup=name)
    said = f"%{{x:.3g}} {unit}: %{{y:.4g}} N<extra>{name}</extra>"
    line = trace(x, median, "lines", legendgroup=name, line={"width": 2, **look}, hovertemplate=said)
    return [{**lower, "name": f"{name}, 2.5 %"}, {**upper, "name": f"{name}, 97.5 %"}, {**line, "name": name}]


def _figures(document: Contrast, pair: Pair) -> list[Figure]:
    """Forces along ramps and in a hold, and ratios of the numbers."""
    loading, hold = [], []
    for name, ink in ((pair.one, "data"), (pair.other, "model")):
        curve = next(one for one in document.curves if one.name == name)
        for place, ramp in enumerate(curve.loading, 1):
            look = {"ink": ink, "dash": "dash" if place < len(curve.loading) else "solid"}
            words = f"{name}, {number(ramp.speed_mm_s, 3)} mm/s"
            loading += _banded(ramp.depth_mm, ramp, 0, words, look, "mm")
        # the first point is time 0, which a logarithmic axis has not
        hold += _banded(curve.hold.time_s, curve.hold, 1, name, {"ink": ink, "dash": "solid"}, "s")
    ratios = [(row.name, row.ratio) for row in reversed(pair.numbers) if row.ratio is not None]
    bars = {"array": [high - middle for _, (_, middle, high) in ratios]}
    bars["arrayminus"] = [middle - low for _, (low, middle, _) in ratios]
    marks: dict[str, Any] = {
        "marker": {"ink": "model", "size": 9},
        "hovertemplate": "%{y}: %{x:.4g}<extra></extra>",
    }
    error = {"type": "data", "symmetric": False, **bars, "ink": "model"}
    middles, names = [middle for _, (_, middle, _) in ratios], [name for name, _ in ratios]
    ratio = trace(middles, names, "markers", name="ratio", showlegend=False, error_x=error, **marks)
    equal = {"type": "line", "x0": 1, "x1": 1, "y0": 0, "y1": 1, "yref": "paper", "line": DASHED}
    layout = {"yaxis": {"type": "category", "automargin": True}, "shapes": [equal]}
    return [
        Figure("Loading", "Depth [mm]", "Force [N]", loading),
        Figure("Hold", "Time after the ramp [s]", "Force [N]", hold, LOG_X),
        Figure("Ratios", "Ratio", "", [ratio], layout),
    ]


def render_contrast(document: Contrast, *, created: str | None = None) -> str:
    """Write the page."""
    names = [one.name for one in document.tissues]
    return render_page(
        "contrast",
        title=" and ".join(names) if len(names) <= 3 else f"{len(names)} tissues compared",
        run=document,
        verdict=contrast_verdict(document),
        pairs=[(pair, pair_verdict(pair, document.level)) for pair in document.pairs],
        probability=_probability,
        figures=[one for pair in document.pairs for one in _figures(document, pair)],
        created=created,
    )
