"""Curves, draws and chains behind the figures, each once, thinned and packed for the page's script."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, evenly, kept_samples
from tissueid.documents.identification import Specimen, Trial
from tissueid.report.uncertainty_words import reported_order
from tissueid.report.wording import trial_label, unit_words
from tissueid.result import Curve
from tissueid.store.curves import TrialCurve
from tissueid.store.posteriors import StoredPosterior

#: Bytes that the curves of a page may take in all, so that it stays below 7 MB: of one specimen, and of many,
#: whose draws need room; a sample takes 23, and 33 with a band.
_BYTES_OF_ONE, _BYTES_OF_MANY = 3_300_000, 900_000
_SAMPLE_BYTES, _BANDED_BYTES = 23, 33
_FEWEST_A_TRIAL = 40
#: Steps of a column that is packed in 16 bits.
_STEPS = 65_535


def curve_bytes(specimens: int) -> int:
    """Bytes for all curves of a page of so many specimens."""
    return _BYTES_OF_MANY + (_BYTES_OF_ONE - _BYTES_OF_MANY) // max(specimens, 1)


def thinned(curve: Curve, most: int) -> NDArray[np.intp]:
    """Indices of at most so many samples (6 or more) that keep the extremes of force and of residual."""
    return kept_samples((curve.force_N, curve.force_N - curve.model_N), most, most - 2)


def packed(values: NDArray[Any], kind: str = "<f4") -> str:
    """Numbers as base64 of their little-endian bytes."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")


def quantised(columns: NDArray[np.float64]) -> dict[str, Any]:
    """Columns of draws as 16-bit steps of their range: finer than a pixel, and half the bytes.

    ``columns`` (n, p).  Returns ``low`` and ``high`` of every column, and ``steps``: base64 of one column
    after the other.
    """
    low, high = columns.min(axis=0), columns.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    steps = np.round((columns - low) / span * _STEPS)
    return {"low": low.tolist(), "high": high.tolist(), "steps": packed(steps.T.ravel(), "<u2")}


def curves_by_trial(
    specimens: Sequence[Specimen], curves: Sequence[TrialCurve]
) -> list[list[tuple[Trial, TrialCurve]]]:
    """Trials of every specimen that have a curve, in their order, each with it."""
    waiting: dict[tuple[str, str, str | None], list[TrialCurve]] = {}
    for entry in curves:
        waiting.setdefault((entry.specimen, entry.path, entry.sheet), []).append(entry)
    found = []
    for specimen in specimens:
        pairs = []
        for trial in specimen.trials:
            own = waiting.get((specimen.specimen, trial.path, trial.sheet))
            if own:
                pairs.append((trial, own.pop(0)))
        found.append(pairs)
    return found


def curve_payload(
    specimens: Sequence[Specimen], curves: Sequence[TrialCurve], posteriors: Sequence[StoredPosterior] = ()
) -> list[list[dict[str, Any]]]:
    """Curves of every specimen, in the order of its trials, packed.

    ``curves``: trials without a curve are left out; ``posteriors``: whose predictive bands are drawn behind
    the data.  Returns per specimen and trial: ``label`` and base64 ``t, x, f, m`` (float32: s, mm, N, N),
    ``on`` (uint8), and ``low, high`` (float32: N) where there is a band.
    """
    bands = {(one.specimen, *trial): band for one in posteriors for trial, band in one.bands.items()}
    most = curve_bytes(len(specimens)) // (_BANDED_BYTES if bands else _SAMPLE_BYTES)
    share = max(most // max(len(curves), 1), _FEWEST_A_TRIAL)
    return [
        [
            {
                "label": trial_label(trial),
                **_columns(own.curve, bands.get((own.specimen, own.path, own.sheet)), share),
            }
            for trial, own in pairs
        ]
        for pairs in curves_by_trial(specimens, curves)
    ]


def _columns(curve: Curve, band: NDArray[np.float64] | None, most: int) -> dict[str, str]:
    index = thinned(curve, most)
    ends: dict[str, str] = {}
    if band is not None and band.shape[1] == curve.time_s.size:
        ends = {"low": packed(band[0, index], "<f4"), "high": packed(band[-1, index], "<f4")}
    channels = {"t": curve.time_s, "x": curve.depth_mm, "f": curve.force_N, "m": curve.model_N}
    drawn = {name: packed(values[index], "<f4") for name, values in channels.items()}
    return {**drawn, "on": packed(curve.fitted[index], "u1"), **ends}


#: Numbers of draws a page may carry in all, at 2.7 bytes each, and the fewest and most draws of a specimen.
MOST_NUMBERS = 180_000
_DRAWS_OF_ONE = (60, 1_000)
#: Chains and draws of each that a trace shows: more lines hide each other; and the numbers of all of them.
_CHAINS, _MOST_STEPS = 4, 250
MOST_CHAIN_NUMBERS = 90_000
_FEWEST_STEPS = 40
#: Viscosities beside theta, at the most.
_BRANCHES = 3
#: Depth, as a fraction of the fitted one, at which viscosity is quoted where K varies.
_REFERENCE_DEPTH = 0.5


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
    shown = _with_viscosity(stored.theta_names, stored.draws[:1], specimen.validity.depth_mm)
    entries = [entry for entry in reported_order(specimen.parameters) if entry.name in shown]

    def table(draws: FloatArray) -> dict[str, Any]:
        kept_draws = draws[evenly(len(draws), most)]
        columns = _with_viscosity(stored.theta_names, kept_draws, specimen.validity.depth_mm)
        kept = [columns[entry.name] for entry in entries]
        return {**quantised(np.column_stack(kept)), "count": len(kept[0])}

    chain = stored.chain[evenly(stored.chain.shape[0], _CHAINS)]
    chain = chain[:, evenly(chain.shape[1], steps)]
    return {
        "names": [entry.name for entry in entries],
        "labels": [
            f"{entry.symbol} [{unit_words(entry.unit)}]" + ("" if entry.identified else ", not identified")
            for entry in entries
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

    Returns ``names``, ``labels`` (with units), ``draws`` and ``total`` (with the count of each) and ``chain``
    (names, shape; a column a coordinate, by chain and draw), all three as :func:`quantised` packs them.
    """
    by_name = {one.specimen: one for one in posteriors}
    fewest, largest = _DRAWS_OF_ONE
    columns = sum(
        (len(one.theta_names) + _BRANCHES) * (1 if one.draws_total is None else 2) for one in posteriors
    )
    share = min(max(MOST_NUMBERS // max(columns, 1), fewest), largest)
    coordinates = sum(_CHAINS * len(one.chain_names) for one in posteriors)
    steps = min(max(MOST_CHAIN_NUMBERS // max(coordinates, 1), _FEWEST_STEPS), _MOST_STEPS)
    return [
        None
        if specimen.specimen not in by_name
        else _of_one(specimen, by_name[specimen.specimen], share, steps)
        for specimen in specimens
    ]
