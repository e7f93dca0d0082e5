"""The page of ``tissueid compare``: whether tissues differ, by how much, and whether a hand could tell.

Self-contained like the report.
"""

from __future__ import annotations

from collections.abc import Sequence

from tissueid.digits import number
from tissueid.documents.contrast import Contrast, Pair
from tissueid.report.page import asset, page_environment, plotly_script
from tissueid.report.wording import Verdict

#: A difference below this many just-noticeable ones is not felt.
NOTICED = 1.0
#: A probability below this is said to be below it.
SMALL = 0.001


def contrast_verdict(document: Contrast) -> Verdict:
    """Verdict of all pairs together.

    ``document``: of ``schemas/contrast.schema.json``.
    """
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
    """Verdict of one pair.

    ``level``: below it tissues are called different.
    """
    found = pair.difference
    chance = f"p {_probability(found.probability)}, level {100 * level:g} %"
    names = f"{pair.one} and {pair.other}"
    felt = [one for one in pair.noticed if one.times > NOTICED]
    hand = "No difference exceeds a published just-noticeable one: a hand would hardly tell."
    if felt:
        most = max(felt, key=lambda one: float(one.times))
        hand = (
            f"A hand could tell by the {most.name}: {number(most.times, 2)} times the just-noticeable "
            "difference."
        )
    if found.different:
        return Verdict("note", f"{names} differ", f"All forces together ({chance}). {hand}")
    equal = "That is no proof of being equal: look at the intervals of the ratios."
    return Verdict(
        "ok", f"{names} are not shown to differ", f"All forces together ({chance}). {equal} {hand}"
    )


def _probability(value: float) -> str:
    """A probability in words: the digits of a tiny one say nothing."""
    return f"below {SMALL}" if value < SMALL else f"= {number(value, 2)}"


def _interval(values: Sequence[float] | None) -> str:
    """A median with its 95 % interval."""
    if values is None:
        return "–"
    low, middle, high = values
    return f"{number(middle, 4)} ({number(low, 3)} to {number(high, 3)})"


def render_contrast(document: Contrast, *, created: str | None = None) -> str:
    """Write the page.

    ``document``: the document of ``schemas/contrast.schema.json``; ``created``: time stamp to print; without
    it equal input gives an equal page.  Returns HTML, UTF-8.
    """
    views = [
        {
            "id": f"pair-{position + 1}",
            "position": position,
            "data": pair,
            "verdict": pair_verdict(pair, document.level),
        }
        for position, pair in enumerate(document.pairs)
    ]
    drawn = [{"one": pair.one, "other": pair.other, "numbers": pair.numbers} for pair in document.pairs]
    return (
        page_environment()
        .get_template("contrast.html.j2")
        .render(
            title=" and ".join(one.name for one in document.tissues)
            if len(document.tissues) <= 3
            else f"{len(document.tissues)} tissues compared",
            run=document,
            verdict=contrast_verdict(document),
            views=views,
            interval=_interval,
            probability=_probability,
            payload={"curves": document.curves, "pairs": drawn},
            created=created,
            style=asset("page.css") + asset("selfcheck.css"),
            scripts=[asset("boxes.js"), asset("contrast.js")],
            plotly=plotly_script(),
        )
    )
