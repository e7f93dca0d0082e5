"""Everything that is recomputed, as one document."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from tissueid import __version__
from tissueid.documents import plain
from tissueid.reproduce.controller import controlled_contact, table_3
from tissueid.reproduce.hip import guidance_forces, restitutions
from tissueid.reproduce.published import (
    PIRES,
    PUBLISHED,
    SADEGHNEJAD,
    Figure,
    Item,
    Kind,
    Numbers,
    Readings,
)
from tissueid.reproduce.recordings import Effort, identified_table, specimen_scatter
from tissueid.reproduce.relaxation import relaxation_tests
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
#: What of the papers can't be had at all.
LOST = (
    "the recordings of either paper",
    "standard deviations of Fig. 4, and every number on the axes of Figs. 3 to 5",
    "the coefficients of the static force",
    "the inputs and the virtual mass of the controller's simulation",
    "stiffness, surface and scales of the guidance environment",
)


def reproduction(
    papers: tuple[str, ...],
    readings: Readings,
    effort: Effort,
    numbers: Numbers = PUBLISHED,
) -> dict[str, Any]:
    """Recompute papers."""
    began = time.perf_counter()
    items: list[Item] = []
    figures: list[Figure] = []
    if SADEGHNEJAD in papers:
        _sinus(items, figures, readings, effort, numbers)
    if PIRES in papers:
        effort.progress("Paper B: restitution and guidance")
        items += restitutions(numbers)
        _add(items, figures, guidance_forces(readings, numbers))
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


def _add(items: list[Item], figures: list[Figure], found: tuple[list[Item], Figure]) -> None:
    items += found[0]
    figures.append(found[1])


def _sinus(
    items: list[Item],
    figures: list[Figure],
    readings: Readings,
    effort: Effort,
    numbers: Numbers,
) -> None:
    """Paper A in the order of its tables and figures."""
    figures.append(_drawn("figure-1", "Fig. 1", "The modified Kelvin-Voigt model", "schematic"))
    _add(items, figures, relaxation_tests(readings, effort, numbers))
    _add(items, figures, force_displacement(readings, numbers))
    _add(items, figures, peak_against_speed(readings, numbers))
    items += identified_table(readings, effort, numbers)
    _add(items, figures, specimen_scatter(readings, effort, numbers))
    items += table_3(readings, numbers)
    figures.append(_drawn("figure-6", "Fig. 6", "The controller of an admittance display", "block-diagram"))
    rows, runs = controlled_contact(readings, effort, numbers)
    items += rows
    figures += runs


def _drawn(key: str, where: str, title: str, drawing: str) -> Figure:
    return Figure(
        key,
        SADEGHNEJAD,
        where,
        title,
        Kind.RECOMPUTED,
        "Drawn from the paper's words; nothing is computed.",
        drawing=drawing,
    )
