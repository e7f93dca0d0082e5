"""The numbers behind the figures, packed for the page.

A page carries each curve once, as base64 of little-endian 32-bit floats; one script on the page makes
every figure from it when it comes into view.  Thirty full figure specifications would be ten times
larger and would be drawn whether or not anybody looks.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.documents.identification import Specimen, Trial
from tissueid.report.remarks import trial_label
from tissueid.result import Curve
from tissueid.store.curves import TrialCurve
from tissueid.store.posteriors import StoredPosterior

#: Bytes that the curves of a page may take in all, so that it stays below 7 MB: of one specimen, and of many,
#: whose draws need room; a sample takes 23, and 33 with a band.
_BYTES_OF_ONE, _BYTES_OF_MANY = 3_300_000, 900_000
_SAMPLE_BYTES, _BANDED_BYTES = 23, 33
_FEWEST_A_TRIAL = 40
_KEPT_A_BUCKET = 4
#: Steps of a column that is packed in 16 bits.
_STEPS = 65_535


def curve_bytes(specimens: int) -> int:
    """Bytes for all curves of a page of so many specimens."""
    return _BYTES_OF_MANY + (_BYTES_OF_ONE - _BYTES_OF_MANY) // max(specimens, 1)


def thinned(curve: Curve, most: int) -> NDArray[np.intp]:
    """Indices that keep the shape: in every stretch the extremes of force and of residual, and the ends.

    ``most``: samples to keep at the most (at least 6).  Returns ascending.
    """
    size = curve.time_s.size
    if size <= most:
        return np.arange(size)
    edges = np.linspace(0, size, max((most - 2) // _KEPT_A_BUCKET, 1) + 1).astype(int)
    residual = curve.force_N - curve.model_N
    keep = {0, size - 1}
    for start, stop in pairwise(edges):
        for values in (curve.force_N[start:stop], residual[start:stop]):
            keep.update((int(start + values.argmin()), int(start + values.argmax())))
    return np.array(sorted(keep))


def packed(values: NDArray[Any], kind: str) -> str:
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
    """Trials of every specimen that have a curve, in their order, each with it.

    ``specimens``: ``specimens`` of identification.json.
    """
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
    specimens: Sequence[Specimen],
    curves: Sequence[TrialCurve],
    posteriors: Sequence[StoredPosterior] = (),
) -> list[list[dict[str, Any]]]:
    """Curves of every specimen, in the order of its trials, packed.

    ``specimens``: ``specimens`` of identification.json; ``curves``: trials without a curve are left out;
    ``posteriors``: whose predictive bands are drawn behind the data.  Returns per specimen and trial:
    ``label`` and base64 ``t, x, f, m`` (float32: s, mm, N, N), ``on`` (uint8), and ``low, high`` (float32: N)
    where there is a band.
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
    return {
        "t": packed(curve.time_s[index], "<f4"),
        "x": packed(curve.depth_mm[index], "<f4"),
        "f": packed(curve.force_N[index], "<f4"),
        "m": packed(curve.model_N[index], "<f4"),
        "on": packed(curve.fitted[index], "u1"),
        **ends,
    }
