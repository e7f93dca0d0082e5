"""Everything that is recomputed, as one document."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any

from tissueid import __version__
from tissueid.documents import plain
from tissueid.documents.reproduction import Figure, Item
from tissueid.reproduce.controller import controlled_contact, table_3
from tissueid.reproduce.hip import guidance_forces, restitutions
from tissueid.reproduce.published import PIRES, SADEGHNEJAD, Drawing, Ledger, Readings
from tissueid.reproduce.recordings import Effort, identified_table, relaxation_tests, specimen_scatter
from tissueid.reproduce.speeds import force_displacement, peak_against_speed

PAPERS = (SADEGHNEJAD, PIRES)
PAPER_WORDS: Mapping[str, str] = {
    SADEGHNEJAD: "Sadeghnejad et al.: Phenomenological Contact Model Characterization and Haptic Simulation "
    "of an Endoscopic Sinus and Skull Base Surgery Virtual System",
    PIRES: "Pires et al.: Haptic Positioning Environment for the Hip Resurfacing Surgery",
}
#: Tables and figures in the order of a page.
PLACES: Mapping[str, tuple[str, ...]] = {
    SADEGHNEJAD: (
        *("Fig. 1", "Table 1", "Fig. 2", "Fig. 3", "Fig. 4", "Table 2"),
        *("Fig. 5", "Table 3", "Fig. 6", "Fig. 7"),
    ),
    PIRES: ("Equation (1)", "Fig. 4"),
}
#: Rows, and a figure or several.
_Part = tuple[list[Item], Figure | list[Figure]]
#: What of the papers can't be had at all.
LOST = (
    "the recordings of either paper",
    "standard deviations of Fig. 4, and every number on the axes of Figs. 3 to 5",
    "the coefficients of the static force",
    "the inputs and the virtual mass of the controller's simulation",
    "stiffness, surface and scales of the guidance environment",
)


def reproduction(papers: tuple[str, ...], readings: Readings, effort: Effort) -> dict[str, Any]:
    """Recompute papers."""
    began = time.perf_counter()
    items: list[Item] = []
    figures: list[Figure] = []
    for paper, parts in ((SADEGHNEJAD, _sinus), (PIRES, _hip)):
        for rows, drawn in parts(readings, effort) if paper in papers else ():
            items += rows
            figures += [drawn] if isinstance(drawn, Figure) else drawn
    return {
        "schema": "tissueid/reproduction/1",
        "tissueid": __version__,
        "papers": [
            {"name": name, "words": PAPER_WORDS[name], "places": list(PLACES[name])} for name in papers
        ],
        "seed": effort.seed,
        "seconds": time.perf_counter() - began,
        "readings": readings.as_json(),
        "items": plain(items),
        "figures": plain(figures),
        "lost": list(LOST),
    }


def _sinus(readings: Readings, effort: Effort) -> Iterator[_Part]:
    """Paper A in the order of its tables and figures."""
    yield [], _drawn("figure-1", "Fig. 1", "The modified Kelvin-Voigt model", "schematic")
    yield relaxation_tests(readings, effort)
    yield force_displacement(readings)
    yield peak_against_speed(readings)
    yield identified_table(readings, effort), []
    yield specimen_scatter(readings, effort)
    yield (
        table_3(readings),
        _drawn("figure-6", "Fig. 6", "The controller of an admittance display", "block-diagram"),
    )
    yield controlled_contact(readings, effort)


def _hip(readings: Readings, effort: Effort) -> Iterator[_Part]:
    """Paper B."""
    effort.progress("Paper B: restitution and guidance")
    yield restitutions(), []
    yield guidance_forces(readings)


def _drawn(key: str, where: str, title: str, drawing: Drawing) -> Figure:
    words = (title, "Drawn from the paper's words; nothing is computed.")
    return Ledger(SADEGHNEJAD, where).figure(key, "recomputed", words, ("", ""), (), drawing=drawing)
