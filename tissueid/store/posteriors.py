"""The draws of every specimen's posterior in one file, so that a report or an export never samples again.

Layout: one group a specimen, in the order of ``index`` (JSON text: specimen, names, trials)::

    posteriors.h5
    |  attributes: format = "tissueid/posteriors/1"
    |-- index                  JSON text
    `-- 0, 1, ...
        |-- draws              (n, p)             theta of the contact model, every row passive
        |-- log_prior          (n,)              of each of them, up to a constant
        |-- draws_total        (n, p)             with the calibration nuisances, where they were drawn
        |-- chain              (chains, draws, d) sampled coordinates
        |-- log_density        (chains, draws)    of the posterior, where a chain was walked
        |-- bands              (3, m)             float32: low, median, high [N] of all trials end to end
        `-- offsets            (trials + 1,)      where each trial's band begins and ends
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, evenly
from tissueid.result import SpecimenFit
from tissueid.store import hdf5
from tissueid.store.files import json_bytes

_FORMAT = "tissueid/posteriors/1"
_BAND_ROWS = 3
#: Points of a chain that are kept: diagnostics of so many equal those of all within their error.
MOST_POINTS = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class StoredPosterior:
    """Stored part of one specimen's posterior beside its numbers."""

    specimen: str
    theta_names: tuple[str, ...]
    draws: FloatArray  # (n, p)
    draws_total: FloatArray | None  # (n, p)
    chain_names: tuple[str, ...]
    chain: FloatArray  # (chains, draws, d), at most :data:`MOST_POINTS` points
    #: (path, sheet) of a trial -> shape (3, m): low, median, high [N] at the samples of its curve.
    bands: Mapping[tuple[str, str | None], FloatArray] = field(default_factory=dict)
    log_density: FloatArray | None = None  # (chains, draws)
    #: (n,): log prior density of the rows of ``draws``, up to a constant; files of older runs have none.
    log_prior: FloatArray | None = None

    def to_arviz(self) -> Any:
        """The draws as arviz knows them; see :func:`tissueid.uncertainty.arviz_data`."""
        from tissueid.uncertainty import arviz_data

        return arviz_data(self, specimen=self.specimen)


def posteriors_of_fits(fits: Iterable[SpecimenFit]) -> tuple[StoredPosterior, ...]:
    """Collect the posteriors of the fits that have one, in their order."""
    as_they_are = ("theta_names", "draws", "draws_total", "chain_names", "bands", "log_prior")
    return tuple(
        StoredPosterior(
            specimen=fit.specimen,
            chain=_thinned(own.chain),
            log_density=None if own.log_density is None else _thinned(own.log_density),
            **{name: getattr(own, name) for name in as_they_are},
        )
        for fit in fits
        if (own := fit.posterior) is not None
    )


def _thinned(chain: FloatArray) -> FloatArray:
    """At most :data:`MOST_POINTS` points, every chain thinned evenly."""
    chains, draws = chain.shape[:2]
    return chain[:, evenly(draws, max(MOST_POINTS // max(chains, 1), 1))]


def put_posteriors(file: Any, posteriors: Iterable[StoredPosterior]) -> None:
    """Write posteriors into an open HDF5 file or a group of one; equal posteriors give equal bytes."""
    file.attrs["format"] = _FORMAT
    index = []
    for position, one in enumerate(posteriors):
        trials = [{"path": where, "sheet": sheet} for where, sheet in one.bands]
        names = {"theta_names": list(one.theta_names), "chain_names": list(one.chain_names)}
        index.append({"specimen": one.specimen, **names, "trials": trials})
        bands = np.concatenate([*one.bands.values(), np.empty((_BAND_ROWS, 0))], axis=1)
        columns: dict[str, NDArray[Any]] = {
            "draws": one.draws.astype("<f8"),
            "chain": one.chain.astype("<f8"),
            "bands": bands.astype("<f4"),
            "offsets": hdf5.offsets_of([band.shape[1] for band in one.bands.values()]),
        }
        for name in ("draws_total", "log_density", "log_prior"):
            if (values := getattr(one, name)) is not None:
                columns[name] = values.astype("<f8")
        hdf5.put_columns(file.create_group(str(position), track_order=False), columns)
    hdf5.put_text(file, "index", json_bytes(index))


def load_posteriors(path: Path | str) -> tuple[StoredPosterior, ...]:
    """Read a file of posteriors; BundleError if it is missing, damaged or of another kind."""
    again = "copy it again or run `tissueid fit` again"
    with hdf5.open_file(Path(path), "posteriors", again, "it where a posterior was sampled") as file:
        return get_posteriors(file)


def get_posteriors(file: Any) -> tuple[StoredPosterior, ...]:
    """Read what :func:`put_posteriors` wrote; ``ValueError`` or ``KeyError`` where it is something else."""
    hdf5.check_format(file, _FORMAT)
    index = json.loads(hdf5.get_text(file, "index"))
    return tuple(_posterior(entry, file[str(position)]) for position, entry in enumerate(index))


def _posterior(entry: Mapping[str, Any], group: Any) -> StoredPosterior:
    columns = hdf5.get_columns(group)
    offsets, size = columns["offsets"], len(entry["theta_names"])
    whole = (
        columns["draws"].shape[1:] == (size,)
        and columns["chain"].shape[2:] == (len(entry["chain_names"]),)
        and columns.get("log_density", columns["chain"]).shape[:2] == columns["chain"].shape[:2]
        and columns.get("log_prior", columns["draws"]).shape[:1] == columns["draws"].shape[:1]
        and offsets.size == len(entry["trials"]) + 1
        and columns["bands"].shape == (_BAND_ROWS, offsets[-1])
    )
    if not whole:
        raise ValueError(f"its index does not match the numbers of {entry['specimen']!r}")
    trials = [(trial["path"], trial["sheet"]) for trial in entry["trials"]]
    kept = ("draws", "draws_total", "chain", "log_density", "log_prior")
    arrays: dict[str, Any] = {name: columns.get(name) for name in kept}
    return StoredPosterior(
        specimen=entry["specimen"],
        theta_names=tuple(entry["theta_names"]),
        chain_names=tuple(entry["chain_names"]),
        bands={
            trial: columns["bands"][:, start:stop].astype(np.float64)
            for trial, start, stop in zip(trials, offsets[:-1], offsets[1:], strict=True)
        },
        **arrays,
    )
