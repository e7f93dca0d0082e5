"""One simulation of a tissue under a protocol: truth, recordings, and what ``fit`` infers from them.

The inference is that of a fit whose contact points are known up to their priors and whose model order is
fixed: sums, optimum, whitening, the posterior's target, the sampler, and the redraw of what was integrated.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid import __version__
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.posterior.total_intervals import total_intervals
from tissueid.priors import Priors
from tissueid.selfcheck.inference import Inferred, infer
from tissueid.selfcheck.protocol import Centre, Protocol
from tissueid.selfcheck.recording import ProtocolLog, simulated_logs
from tissueid.selfcheck.records import Replicate
from tissueid.selfcheck.truth import Widths, centred_priors, draw_truth, force_points, numbers_of

__all__ = ["TissueCheck", "described", "tissue_check"]

FloatArray = NDArray[np.float64]

#: An instrument without a defect.
PERFECT = {
    "force_gain": 1.0,
    "displacement_gain": 1.0,
    "skew_s": 0.0,
    "force_filter_s": 0.0,
    "frame_compliance_mm_per_N": 0.0,
}


@dataclass(frozen=True, slots=True, eq=False)
class TissueCheck:
    """Draws a tissue, records it, infers it.

    Attributes
    ----------
    model : KelvinVoigt
    logs : tuple of ProtocolLog
    priors : Priors
        Proper ones: truths come from them, and the inference knows them.
    pooling : str
        ``partial``, ``shared`` or ``per-log``.
    correlated : bool
        Noise with phi.
    white_share : float
        Share of its variance that is white beside the correlated part.
    defects : bool
        Calibration nuisances are drawn, and the total posterior is checked.
    sampler : str
        ``exact`` or ``emcee``.
    reference_step_s : float
        Step over which phi is the correlation: the finest of the logs' median steps.
    points : tuple of tuple
        (depth, speed) at which the force is checked.
    stated : tuple of str
        Names whose prior the study states.
    instrument : mapping or None
        The one instrument of every truth, instead of drawn defects: is it covered though it is unknown?
    """

    model: KelvinVoigt
    logs: tuple[ProtocolLog, ...]
    priors: Priors
    pooling: str
    correlated: bool
    white_share: float
    defects: bool
    sampler: str
    reference_step_s: float
    points: tuple[tuple[float, float], ...]
    stated: tuple[str, ...] = field(default=())
    instrument: Mapping[str, float] | None = None

    @property
    def noise_model(self) -> str:
        """``white``, ``ar1`` or ``white+ar1``."""
        if not self.correlated:
            return "white"
        return "white+ar1" if self.white_share > 0.0 else "ar1"

    def _numbers(self, theta: FloatArray) -> dict[str, FloatArray]:
        """What is checked of tissues; logs with static curves of their own share K and tau only."""
        numbers = numbers_of(self.model, theta, self.points)
        if self.pooling != "per-log":
            return numbers
        return {name: value for name, value in numbers.items() if not name.startswith(("static", "force"))}

    def _quoted(self, found: Inferred) -> dict[str, tuple[float, float]]:
        """Intervals of the tissue that a fit quotes, where they are not central ones."""
        if not self.defects:
            return {}
        priors = self.priors.calibration
        return total_intervals(
            self._numbers(found.theta),
            {name: values for name, values in found.others.items() if name in priors},
            priors,
            cluster=found.source,
        )

    def __call__(self, rng: np.random.Generator) -> Replicate:
        """One simulation."""
        offset_sd = np.array([log.contact_sd_mm for log in self.logs])
        truth = draw_truth(
            self.model,
            self.priors,
            offset_sd_mm=offset_sd,
            pooling=self.pooling,
            correlated=self.correlated,
            defects=self.defects,
            rng=rng,
        )
        if self.instrument is not None:
            truth = replace(truth, calibration=dict(self.instrument))
        data = simulated_logs(
            self.model,
            truth,
            self.logs,
            reference_step_s=self.reference_step_s,
            white_share=self.white_share,
            rng=rng,
        )
        found = infer(self, data, rng)
        true = {name: float(value[0]) for name, value in self._numbers(truth.theta[None]).items()}
        draws = self._numbers(found.theta)
        own = {"sigma_N": truth.sigma_N, "phi": truth.phi, "gain_sd": truth.gain_sd}
        own |= PERFECT | dict(truth.calibration)
        for name, values in found.others.items():
            true[name] = own[name]
            draws[name] = values
        return Replicate(truth=true, draws=draws, detail=found.detail, quoted=self._quoted(found))


def tissue_check(
    protocol: Protocol,
    centre: Centre,
    *,
    stated: Priors | None = None,
    widths: Widths | None = None,
    defects: bool = False,
    sampler: str = "exact",
) -> TissueCheck:
    """The check of a tissue under a protocol, with proper priors around it.

    Parameters
    ----------
    protocol : Protocol
    centre : Centre
    stated : Priors, optional
        Of a study: what it states stays.
    widths : Widths, optional
    defects : bool
        Draw calibration nuisances and check the total posterior.
    sampler : str
        ``exact`` or ``emcee``.
    """
    stated = stated or Priors()
    return TissueCheck(
        model=centre.model,
        logs=protocol.logs,
        priors=centred_priors(
            centre.model, centre.theta, sigma_N=centre.sigma_N, phi=centre.phi, stated=stated, widths=widths
        ),
        pooling=centre.pooling,
        correlated=centre.phi > 0.0,
        white_share=centre.white_share,
        defects=defects,
        sampler=sampler,
        reference_step_s=protocol.step_s,
        points=force_points(centre.model.depth_mm, protocol.speeds_mm_s),
        stated=_stated_names(stated),
    )


def described(check: TissueCheck) -> dict[str, Any]:
    """Everything that decides a simulation, as JSON: what two calls must share to go on with each other."""
    priors = check.priors
    return {
        "version": __version__,
        "model": [check.model.branches, check.model.stiffness_degree, check.model.depth_mm],
        "linear": {name: list(pair) for name, pair in priors.linear.items()},
        "times": [[time.median, time.sd_ln] for time in priors.relaxation_time_s],
        "sigma": None if priors.sigma_N is None else [priors.sigma_N.median, priors.sigma_N.sd_ln],
        "noise": [check.noise_model, list(priors.phi), check.white_share, check.reference_step_s],
        "gain": [check.pooling, priors.gain_sd],
        "calibration": {
            name: [one.mean, one.sd, str(one.lower)]
            for name, one in priors.calibration.items()
            if check.defects
        },
        "instrument": None if check.instrument is None else dict(check.instrument),
        "sampler": check.sampler,
        "points": [list(point) for point in check.points],
        "logs": [
            [log.name, log.contact_sd_mm]
            + [
                hashlib.sha256(np.ascontiguousarray(part).tobytes()).hexdigest()
                for part in (log.time_s, log.depth_mm, log.include)
            ]
            for log in check.logs
        ],
    }


def _stated_names(priors: Priors) -> tuple[str, ...]:
    """Names of :func:`~tissueid.selfcheck.truth.prior_words` whose prior a study states."""
    default = Priors()
    names = list(priors.linear)
    names += [
        f"relaxation_time_s{'' if j == 0 else f'_b{j + 1}'}" for j in range(len(priors.relaxation_time_s))
    ]
    names += [
        name for name in ("sigma_N", "phi", "gain_sd") if getattr(priors, name) != getattr(default, name)
    ]
    names += [name for name, prior in priors.calibration.items() if prior.stated]
    return tuple(names)
