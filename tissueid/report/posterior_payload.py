"""Draws and chains behind the figures of a posterior, thinned and packed for the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.report.figures import packed
from tissueid.report.uncertainty_words import reported_order
from tissueid.report.wording import unit_words
from tissueid.store.posteriors import StoredPosterior

__all__ = ["posterior_payload"]

FloatArray = NDArray[np.float64]

#: Draws a page may carry in all, and what a specimen gets of them: 4 bytes a parameter and draw.
MOST_DRAWS = 24_000
_DRAWS_OF_ONE = (200, 1_000)
#: Chains and draws of each that a trace shows: more lines hide each other.
_CHAINS, _STEPS = 4, 250
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
        if terms:
            columns[f"viscosity_N_s_per_mm{suffix}"] = sum(terms) * columns[f"relaxation_time_s{suffix}"]
    return columns


def _of_one(specimen: Mapping[str, Any], stored: StoredPosterior, most: int) -> dict[str, Any]:
    entries = reported_order(specimen["parameters"])
    depth_mm = specimen["validity"]["depth_mm"]

    def table(draws: FloatArray) -> dict[str, Any]:
        columns = _with_viscosity(stored.theta_names, draws[_evenly(len(draws), most)], depth_mm)
        kept = [columns[entry["name"]] for entry in entries if entry["name"] in columns]
        return {"values": packed(np.concatenate(kept), "<f4"), "count": len(kept[0])}

    chain = stored.chain[_evenly(stored.chain.shape[0], _CHAINS)]
    chain = chain[:, _evenly(chain.shape[1], _STEPS)]
    available = {*stored.theta_names, *(e["name"] for e in entries if e["name"].startswith("viscosity"))}
    return {
        "names": [entry["name"] for entry in entries if entry["name"] in available],
        "labels": [
            f"{entry['symbol']} [{unit_words(entry['unit'])}]"
            + ("" if entry["identified"] else ", not identified")
            for entry in entries
            if entry["name"] in available
        ],
        "draws": table(stored.draws),
        "total": None if stored.draws_total is None else table(stored.draws_total),
        "chain": {
            "names": [name.replace("_", " ") for name in stored.chain_names],
            "shape": list(chain.shape),
            "values": packed(chain, "<f4"),
        },
    }


def posterior_payload(
    specimens: Sequence[Mapping[str, Any]], posteriors: Sequence[StoredPosterior]
) -> list[dict[str, Any] | None]:
    """Draws of every specimen, in their order, packed; ``None`` where nothing was sampled.

    Parameters
    ----------
    specimens : sequence of mapping
        ``specimens`` of identification.json.
    posteriors : sequence of StoredPosterior

    Returns
    -------
    list of dict
        ``names``, ``labels`` (with units), ``draws`` and ``total`` (base64 of 32-bit floats, one parameter
        after the other, and the count of each), ``chain`` (names, shape, base64 by chain, draw, coordinate).
    """
    by_name = {one.specimen: one for one in posteriors}
    fewest, largest = _DRAWS_OF_ONE
    share = min(max(MOST_DRAWS // max(len(posteriors), 1), fewest), largest)
    return [
        None
        if specimen["specimen"] not in by_name
        else _of_one(specimen, by_name[specimen["specimen"]], share)
        for specimen in specimens
    ]
