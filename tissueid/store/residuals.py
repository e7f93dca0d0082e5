"""Summaries of residuals beside the curves they belong to.

Layout: ``residual/trial`` says which trials have one; quantities of one length a trial stand in tables, the
others end to end, with ``*_offsets`` between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.residuals import ResidualSummary

_GROUP = "residual"
_TABLES = {"edges_N": "<f8", "counts": "<i8"}
_SERIES = {
    "lags": "<i8",
    "correlation": "<f8",
    "hold_since_s": "<f8",
    "hold_mean_N": "<f8",
    "hold_count": "<i8",
}
#: Which offsets divide a series.
_DIVIDED = {"lags": "lag", "correlation": "lag"}


def put_residuals(group: Any, residuals: Sequence[ResidualSummary | None]) -> None:
    """Write the summaries of trials, in their order, into an open HDF5 file or a group of one."""
    kept = [(i, one) for i, one in enumerate(residuals) if one is not None]
    if not kept:
        return
    found = group.create_group(_GROUP)
    columns: dict[str, NDArray[Any]] = {
        "trial": np.array([i for i, _ in kept], dtype="<i8"),
        "clock_s": np.array([[one.start_s, one.step_s] for _, one in kept], dtype="<f8"),
        "lag_offsets": _offsets([one.lags.size for _, one in kept]),
        "hold_offsets": _offsets([one.hold_count.size for _, one in kept]),
    }
    for name, kind in _TABLES.items():
        columns[name] = np.stack([getattr(one, name) for _, one in kept]).astype(kind)
    for name, kind in _SERIES.items():
        columns[name] = np.concatenate([getattr(one, name) for _, one in kept]).astype(kind)
    for name, values in columns.items():
        packed = {"compression": "gzip", "shuffle": True} if values.size else {}
        found.create_dataset(name, data=values, track_times=False, **packed)


def _offsets(sizes: Sequence[int]) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)]).astype("<i8")


def get_residuals(group: Any, trials: int) -> list[ResidualSummary | None]:
    """Read what :func:`put_residuals` wrote; ``None`` for trials without, and for all of an older file.

    Raises ValueError: its parts do not match.
    """
    residuals: list[ResidualSummary | None] = [None] * trials
    if _GROUP not in group:
        return residuals
    columns = {name: np.asarray(values[()]) for name, values in group[_GROUP].items()}
    where = columns["trial"]
    ends = {name: columns[f"{_DIVIDED.get(name, 'hold')}_offsets"] for name in _SERIES}
    whole = (
        all(columns[name].shape[:1] == where.shape for name in ("clock_s", *_TABLES))
        and all(ends[name].shape == (where.size + 1,) for name in _SERIES)
        and all(columns[name].shape == (ends[name][-1],) for name in _SERIES)
        and columns["counts"].shape[1] == columns["edges_N"].shape[1] + 1
        and (where < trials).all()
    )
    if not whole:
        msg = "its residuals do not match its index"
        raise ValueError(msg)
    for k, trial in enumerate(where.tolist()):
        series = {name: columns[name][ends[name][k] : ends[name][k + 1]] for name in _SERIES}
        residuals[trial] = ResidualSummary(
            start_s=float(columns["clock_s"][k, 0]),
            step_s=float(columns["clock_s"][k, 1]),
            edges_N=columns["edges_N"][k],
            counts=columns["counts"][k],
            **series,
        )
    return residuals
