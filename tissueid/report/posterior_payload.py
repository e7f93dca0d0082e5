"""Draws and chains behind the figures of a posterior, thinned and packed for the page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.documents.identification import Specimen
from tissueid.report.figures import quantised
from tissueid.report.uncertainty_words import reported_order
from tissueid.report.wording import unit_words
from tissueid.store.posteriors import StoredPosterior

#: Numbers of draws a page may carry in all, at 2.7 bytes each, and the fewest and most draws of a specimen.
MOST_NUMBERS = 180_000
_DRAWS_OF_ONE = (60, 1_000)
#: Chains and draws of each that a trace shows: more lines hide each other; and the numbers of all of them.
_CHAINS, _STEPS = 4, 250
MOST_CHAIN_NUMBERS = 90_000
_FEWEST_STEPS = 40
#: Viscosities beside theta, at the most.
_BRANCHES = 3
#: Depth, as a fraction of the fitted one, at which viscosity is quoted where K varies.
_REFERENCE_DEPTH = 0.5


def _evenly(size: int, most: int) -> NDArray[np.intp]:
    return np.linspace(0, size - 1, min(size, most)).astype(np.intp)


def _with_viscosity(names: Sequence[str], draws: FloatArray, depth_mm: float) -> dict[str, FloatArray]:
    """Columns by name; viscosity is K at the reference depth times the relaxation time."""
    columns = dict(zip(names, draws.T, strict=True))
    depth = _REFERENCE_DEPTH * depth_mm
    for suffix in ("", "_b2", "_b3"):
        powers = ("0_N_per_mm", "1_N_per_mm2", "2_N_per_mm3")
        terms = [
            columns[name] * depth**power
            for power, name in enumerate(f"stiffness_{unit}{suffix}" for unit in powers)
            if name in columns
        ]
        if terms and f"relaxation_time_s{suffix}" in columns:
            columns[f"viscosity_N_s_per_mm{suffix}"] = sum(terms) * columns[f"relaxation_time_s{suffix}"]
    return columns


def _of_one(specimen: Specimen, stored: StoredPosterior, most: int, steps: int) -> dict[str, Any]:
    entries = reported_order(specimen.parameters)
    depth_mm = specimen.validity.depth_mm

    def table(draws: FloatArray) -> dict[str, Any]:
        columns = _with_viscosity(stored.theta_names, draws[_evenly(len(draws), most)], depth_mm)
        kept = [columns[entry.name] for entry in entries if entry.name in columns]
        return {**quantised(np.column_stack(kept)), "count": len(kept[0])}

    chain = stored.chain[_evenly(stored.chain.shape[0], _CHAINS)]
    chain = chain[:, _evenly(chain.shape[1], steps)]
    available = {*stored.theta_names, *(e.name for e in entries if e.name.startswith("viscosity"))}
    return {
        "names": [entry.name for entry in entries if entry.name in available],
        "labels": [
            f"{entry.symbol} [{unit_words(entry.unit)}]" + ("" if entry.identified else ", not identified")
            for entry in entries
            if entry.name in available
        ],
        "draws": table(stored.draws),
        "total": None if stored.draws_total is None else table(stored.draws_total),
        "chain": {
            "names": [name.replace("_", " ") for name in stored.chain_names],
            "shape": list(chain.shape),
            **quantised(chain.reshape(-1, chain.shape[2])),
        },
    }


def posterior_payload(
    specimens: Sequence[Specimen], posteriors: Sequence[StoredPosterior]
) -> list[dict[str, Any] | None]:
    """Draws of every specimen, in their order, packed; ``None`` where nothing was sampled.

    ``specimens``: ``specimens`` of identification.json.  Returns ``names``, ``labels`` (with units),
    ``draws`` and ``total`` (with the count of each) and ``chain`` (names, shape; a column a coordinate, by
    chain and draw), all three as :func:`~tissueid.report.figures.quantised` packs them.
    """
    by_name = {one.specimen: one for one in posteriors}
    fewest, largest = _DRAWS_OF_ONE
    columns = sum(
        (len(one.theta_names) + _BRANCHES) * (1 if one.draws_total is None else 2) for one in posteriors
    )
    share = min(max(MOST_NUMBERS // max(columns, 1), fewest), largest)
    coordinates = sum(_CHAINS * len(one.chain_names) for one in posteriors)
    steps = min(max(MOST_CHAIN_NUMBERS // max(coordinates, 1), _FEWEST_STEPS), _STEPS)
    return [
        None
        if specimen.specimen not in by_name
        else _of_one(specimen, by_name[specimen.specimen], share, steps)
        for specimen in specimens
    ]
