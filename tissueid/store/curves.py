"""The curves of every trial in one file, so that a report never needs the raw logs again.

Layout: the samples of all trials stand end to end in one data set a quantity; ``index`` (JSON text) names the
trials and ``offsets`` says where each begins and ends.  Thousands of trials then cost no more than their
numbers. A group ``residual`` holds what the full rate said of the residuals: ``trial`` says which trials have
one; quantities of one length a trial stand in tables, the others end to end, with ``*_offsets`` between them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.result import Curve, ResidualSummary, SpecimenFit
from tissueid.store import hdf5
from tissueid.store.files import json_bytes

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
        "lag_offsets": hdf5.offsets_of([one.lags.size for _, one in kept]),
        "hold_offsets": hdf5.offsets_of([one.hold_count.size for _, one in kept]),
    }
    for name, kind in _TABLES.items():
        columns[name] = np.stack([getattr(one, name) for _, one in kept]).astype(kind)
    for name, kind in _SERIES.items():
        columns[name] = np.concatenate([getattr(one, name) for _, one in kept]).astype(kind)
    hdf5.put_columns(found, columns)


def get_residuals(group: Any, trials: int) -> list[ResidualSummary | None]:
    """Read what :func:`put_residuals` wrote; ``None`` for trials without, and for all of an older file.

    Raises ValueError: its parts do not match.
    """
    residuals: list[ResidualSummary | None] = [None] * trials
    if _GROUP not in group:
        return residuals
    columns = hdf5.get_columns(group[_GROUP])
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
        raise ValueError("its residuals do not match its index")
    for k, trial in enumerate(where.tolist()):
        arrays = {name: columns[name][k] for name in _TABLES}
        arrays |= {name: columns[name][ends[name][k] : ends[name][k + 1]] for name in _SERIES}
        start_s, step_s = columns["clock_s"][k].tolist()
        residuals[trial] = ResidualSummary(start_s=start_s, step_s=step_s, **arrays)
    return residuals


_FORMAT = "tissueid/curves/1"
_QUANTITIES = ("time_s", "depth_mm", "force_N", "model_N")


@dataclass(frozen=True, slots=True)
class TrialCurve:
    """The curve of one trial."""

    specimen: str
    path: str
    sheet: str | None
    curve: Curve
    residual: ResidualSummary | None = None  # curves of older runs have none


def curves_of_fits(fits: Iterable[SpecimenFit]) -> tuple[TrialCurve, ...]:
    """Collect the curves of every trial, in the order of the fits."""
    return tuple(
        TrialCurve(fit.specimen, trial.path, trial.sheet, trial.curve, trial.residual)
        for fit in fits
        for trial in fit.trials
    )


def write_curves(curves: Sequence[TrialCurve], path: Path | str) -> None:
    """Write curves, whole or not at all; equal curves give equal bytes."""
    with hdf5.new_file(Path(path)) as file:
        put_curves(file, curves)


def put_curves(group: Any, curves: Sequence[TrialCurve]) -> None:
    """Write curves into an open HDF5 file or a group of one."""
    sizes = [entry.curve.time_s.size for entry in curves]
    index = [{"specimen": entry.specimen, "path": entry.path, "sheet": entry.sheet} for entry in curves]
    group.attrs["format"] = _FORMAT
    hdf5.put_text(group, "index", json_bytes(index))
    group.create_dataset("offsets", data=hdf5.offsets_of(sizes), track_times=False)
    for name in (*_QUANTITIES, "fitted"):
        parts = [np.asarray(getattr(entry.curve, name)) for entry in curves]
        values = np.concatenate(parts) if parts else np.empty(0)
        hdf5.put_columns(group, {name: values.astype("u1" if name == "fitted" else "<f8")})
    put_residuals(group, [entry.residual for entry in curves])


def load_curves(path: Path | str) -> tuple[TrialCurve, ...]:
    """Read what :func:`write_curves` wrote; BundleError if the file is damaged or another kind of file."""
    again = "copy it again or run `tissueid fit` again"
    with hdf5.open_file(Path(path), "curves", again, "it into its output folder") as file:
        return get_curves(file)


def get_curves(group: Any) -> tuple[TrialCurve, ...]:
    """Read what :func:`put_curves` wrote; ``ValueError`` or ``KeyError`` where it is something else."""
    hdf5.check_format(group, _FORMAT)
    index = json.loads(hdf5.get_text(group, "index"))
    offsets = np.asarray(group["offsets"][()])
    columns = {name: np.asarray(group[name][()]) for name in (*_QUANTITIES, "fitted")}
    if offsets.size != len(index) + 1 or any(column.shape != (offsets[-1],) for column in columns.values()):
        raise ValueError("its index does not match its numbers")
    residuals = get_residuals(group, len(index))
    return tuple(
        TrialCurve(
            entry["specimen"],
            entry["path"],
            entry["sheet"],
            Curve(
                **{name: columns[name][start:stop] for name in _QUANTITIES},
                fitted=columns["fitted"][start:stop].astype(bool),
            ),
            residual,
        )
        for entry, start, stop, residual in zip(index, offsets[:-1], offsets[1:], residuals, strict=True)
    )
