"""The sums of a fitted specimen as they are kept in a file."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.specimen import FittedSpecimen
from tissueid.likelihood.linearise import centre
from tissueid.likelihood.sums import N_STATIC
from tissueid.store.sums import StoredLog, StoredSums

__all__ = ["stored_sums"]


def stored_sums(fitted: FittedSpecimen, hashes: Mapping[tuple[str, str | None], str]) -> StoredSums:
    """Sums with correlated noise of every log, up to the degree of K that was chosen.

    Parameters
    ----------
    fitted : FittedSpecimen
    hashes : mapping
        (path, sheet) of a recording -> the SHA-256 of its file.
    """
    whitened, sums = fitted.whitened, fitted.whitened.sums
    degree, nodes = fitted.optimum.degree, sums.basis.tau_s.size
    keep: NDArray[np.int64] = np.append(
        np.arange(N_STATIC + nodes * (degree + 1)), N_STATIC + nodes * (whitened.lags[0].degree + 1)
    )
    logs = []
    for i, (one, trial) in enumerate(zip(whitened.lags, fitted.fit.trials, strict=True)):
        logs.append(
            StoredLog(
                path=trial.path,
                sheet=trial.sheet,
                sha256=hashes[trial.path, trial.sheet],
                start=one.start[keep][:, keep],
                later=one.later[:, keep][:, :, keep],
                earlier=one.earlier[:, keep][:, :, keep],
                difference=one.difference[:, keep][:, :, keep],
                ratio=one.ratio,
                links=one.links,
                chains=one.chains,
                center=centre(sums.basis, one.degree, whitened.centred, i)[keep[:-1]],
            )
        )
    return StoredSums(
        specimen=fitted.fit.specimen,
        tau_s=sums.basis.tau_s,
        degree=degree,
        scale_mm=sums.depth_mm,
        reference_step_s=whitened.noise.reference_step_s,
        moving_average=whitened.noise.moving_average,
        filter_phi=whitened.noise.phi if whitened.noise.moving_average else 0.0,
        step_s=sums.step_s,
        duration_s=sums.duration_s,
        log_range=sums.log_range,
        logs=tuple(logs),
    )
