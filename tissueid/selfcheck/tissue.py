"""One simulation of a tissue under a protocol: truth, recordings, and what ``identify`` makes of them.

The order of the model is the truth's, and the study states the very priors that the truth was drawn from.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from tissueid import FitOptions, IdentifyOptions, PosteriorOptions, __version__, identify
from tissueid.arrays import FloatArray
from tissueid.manifest import Calibration, Study
from tissueid.model.base import branch_suffix
from tissueid.model.channels import ChannelModel
from tissueid.model.frame import linear_frame
from tissueid.model.grammar import KELVIN_VOIGT
from tissueid.priors import Priors
from tissueid.result import SpecimenFit
from tissueid.segment import SegmentOptions
from tissueid.selfcheck.protocol import Centre, Protocol
from tissueid.selfcheck.records import DRAWS, Replicate
from tissueid.selfcheck.truth import (
    TIME_SD,
    ProtocolLog,
    Truth,
    Widths,
    centred_priors,
    cut_normal,
    drawn_tissue,
    force_points,
    noise,
    numbers_of,
    recorded_force,
)
from tissueid.trial import Source, Trial

#: Effective draws that are asked for: those of a chain are correlated, and ranks want independent ones.
SAMPLED = 2 * DRAWS
#: A machine without a fault, stated so surely that nothing of it is left to be asked: what a statistical
#: interval is of.
KNOWN_MACHINE = Calibration(
    values={
        "load_cell_class": 1e-4,
        "displacement_class": 1e-4,
        "skew_s": 0.0,
        "skew_s_sd": 1e-6,
        "force_filter_s": 0.0,
        "force_filter_s_sd": 1e-6,
    },
    frame=linear_frame(1e6),
)


@dataclass(frozen=True, slots=True, eq=False)
class TissueCheck:
    """Draws a tissue, records it, identifies it."""

    model: ChannelModel
    logs: tuple[ProtocolLog, ...]
    priors: Priors  # proper ones: truths come from them, and the inference knows them
    pooling: str  # ``scaled``, ``partial`` or ``shared``
    correlated: bool  # noise with phi
    white_share: float  # share of its variance that is white beside the correlated part
    defects: bool  # calibration nuisances are drawn, and the total posterior is checked
    reference_step_s: float  # step over which phi is the correlation: the finest of the logs' median steps
    points: tuple[tuple[float, float], ...]  # (depth, speed) at which the force is checked
    stated: tuple[str, ...] = field(default=())  # names whose prior the study states
    #: The one instrument of every truth, instead of drawn defects: is it covered though it is unknown?.
    instrument: Mapping[str, float] | None = None
    #: The contact point is stated with its standard deviation, and not found in the recordings: the posterior
    #: is checked without the segmentation before it.
    contact_stated: bool = False

    @property
    def noise_model(self) -> Literal["white", "ar1", "white+ar1"]:
        """``white``, ``ar1`` or ``white+ar1``."""
        if not self.correlated:
            return "white"
        return "white+ar1" if self.white_share > 0.0 else "ar1"

    @property
    def fit(self) -> FitOptions:
        """The law of the truth, and how its logs are pooled."""
        shared = FitOptions(static=self.pooling, noise=self.noise_model)
        if self.model.name != KELVIN_VOIGT:
            return replace(shared, model=self.model.name)
        return replace(shared, branches=self.model.branches, stiffness_degree=self.model.stiffness_degree)

    @property
    def segmentation(self) -> SegmentOptions:
        """Statement of the contact points: none, or their depth and its standard deviation."""
        if not self.contact_stated:
            return SegmentOptions()
        return SegmentOptions(
            contact_displacement_mm=0.0, contact_sd_mm=max(log.contact_sd_mm for log in self.logs)
        )

    def truth(self, rng: np.random.Generator) -> Truth:
        """A draw from the priors, behind the instrument."""
        priors, logs = self.priors, len(self.logs)
        assert priors.sigma_N is not None  # noqa: S101 -- centred_priors filled it
        theta = drawn_tissue(self.model, priors, rng)
        sigma = priors.sigma_N.median * float(np.exp(priors.sigma_N.sd_ln * rng.standard_normal()))
        phi = float(rng.uniform(*priors.phi)) if self.correlated else 0.0
        spread = abs(priors.gain_sd * float(rng.standard_normal())) if self.pooling != "shared" else 0.0
        unlike = abs(TIME_SD * float(rng.standard_normal())) if self.pooling == "scaled" else 0.0
        known = priors.calibration if self.defects else {}
        drawn = {name: cut_normal(prior, rng) for name, prior in known.items()}
        return Truth(
            theta=theta,
            gain=np.exp(spread * rng.standard_normal(logs)),
            slower=np.exp(unlike * rng.standard_normal(logs)) if unlike else np.ones(logs),
            offset_mm=np.array([log.contact_sd_mm for log in self.logs]) * rng.standard_normal(logs),
            sigma_N=sigma,
            phi=phi,
            gain_sd=spread,
            calibration=drawn if self.instrument is None else dict(self.instrument),
        )

    def trials(self, truth: Truth, rng: np.random.Generator) -> list[Trial]:
        """The recordings of a truth, noise and all, as a machine would export them."""
        out, theta = [], truth.theta.copy()
        own = (truth.gain.tolist(), truth.slower.tolist(), truth.offset_mm.tolist())
        for log, gain, slower, offset in zip(self.logs, *own, strict=True):
            theta[self.model.time_places] = slower * truth.theta[self.model.time_places]
            clean = recorded_force(
                self.model, theta, log, gain=gain, offset_mm=offset, calibration=truth.calibration
            )
            scatter = noise(
                log.time_s,
                sigma_N=truth.sigma_N,
                phi=truth.phi,
                reference_step_s=self.reference_step_s,
                white_share=self.white_share,
                rng=rng,
            )
            source = Source(path=log.name, recipe="simulated")
            time = log.time_s - log.time_s[0]
            out.append(Trial("simulated", time, log.depth_mm, clean + scatter, source=source))
        return out

    def identified(self, trials: Sequence[Trial], *, seed: int) -> SpecimenFit:
        """Identify one specimen from its recordings, with its posterior."""
        options = IdentifyOptions(
            segment=self.segmentation,
            fit=self.fit,
            posterior=PosteriorOptions(draws=SAMPLED, seed=seed),
            seed=seed,
        )
        machine = Calibration() if self.defects else KNOWN_MACHINE
        study = Study("simulated", priors=self.priors, calibration=machine)
        found = identify(trials, study=study, options=options)
        if not found.specimens:
            raise ArithmeticError("; ".join(found.exit.reasons))
        (fit,) = found.specimens
        if fit.posterior is None or not fit.posterior.sampler.converged:
            lost = [flag for flag in fit.flags if flag.code == "sampler_not_converged"]
            said = [f"{flag.message}: {flag.values.get('reason', '')}" for flag in lost]
            raise ArithmeticError("; ".join(said) or "no posterior was sampled")
        return fit

    def _numbers(self, fit: SpecimenFit, theta: FloatArray) -> dict[str, FloatArray]:
        """Numbers that are checked; a viscosity is quoted at half of the depth that was fitted."""
        return numbers_of(replace(self.model, depth_mm=fit.depth_mm), theta, self.points)

    def drawn(self, fit: SpecimenFit) -> FloatArray:
        """The draws behind the intervals that are checked, shape (n, p), in the model's order."""
        posterior = fit.posterior
        assert posterior is not None  # noqa: S101 -- identified saw to it
        draws = posterior.draws_total if self.defects else posterior.draws
        if draws is None or draws.shape[0] < DRAWS:
            msg = f"{0 if draws is None else draws.shape[0]} draws, {DRAWS} are needed to rank a truth"
            raise ArithmeticError(msg)
        return draws[:, [posterior.theta_names.index(name) for name in self.model.parameter_names]]

    def __call__(self, rng: np.random.Generator) -> Replicate:
        """One simulation."""
        truth = self.truth(rng)
        fit = self.identified(self.trials(truth, rng), seed=int(rng.integers(2**31)))
        true = self._numbers(fit, truth.theta[None])
        assert fit.posterior is not None  # noqa: S101 -- identified saw to it
        misfit = fit.posterior.misfit
        detail = {
            "acceptance": float(fit.posterior.sampler.acceptance),
            "identified": float(np.mean([one.identified for one in fit.parameters])),
            "misfit": float(misfit is not None and misfit.raised),
            "logs": float(len(fit.trials)),
        }
        return Replicate(
            truth={name: float(value[0]) for name, value in true.items()},
            draws=self._numbers(fit, self.drawn(fit)),
            detail=detail,
            quoted={name: ends for name, ends in _quoted(fit, total=self.defects).items() if name in true},
        )


def _quoted(fit: SpecimenFit, *, total: bool) -> dict[str, tuple[float, float]]:
    """95 % intervals as they are quoted, by parameter."""
    known = {one.name: one.uncertainty for one in fit.parameters if one.uncertainty is not None}
    ends = {name: one.ci95_total if total else one.ci95 for name, one in known.items()}
    return {name: pair for name, pair in ends.items() if pair is not None and np.isfinite(pair).all()}


def tissue_check(
    protocol: Protocol,
    centre: Centre,
    *,
    stated: Priors | None = None,
    widths: Widths | None = None,
    defects: bool = False,
) -> TissueCheck:
    """The check of a tissue under a protocol, with proper priors around it."""
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
        reference_step_s=protocol.step_s,
        points=force_points(centre.model.depth_mm, protocol.speeds_mm_s),
        stated=_stated_names(stated),
    )


def described(check: TissueCheck) -> dict[str, Any]:
    """Everything that decides a simulation, as JSON: what two calls must share to go on with each other."""
    told = {name: repr(getattr(check, name)) for name in check.__dataclass_fields__ if name != "logs"}
    paths = (log.time_s.tobytes() + log.depth_mm.tobytes() for log in check.logs)
    logs = [
        [log.name, log.contact_sd_mm, hashlib.sha256(path).hexdigest()]
        for log, path in zip(check.logs, paths, strict=True)
    ]
    return {"version": __version__, **told, "logs": logs}


def _stated_names(priors: Priors) -> tuple[str, ...]:
    """Names of :func:`~tissueid.selfcheck.truth.prior_words` whose prior a study states."""
    default = Priors()
    times = [f"relaxation_time_s{branch_suffix(j)}" for j in range(len(priors.relaxation_time_s))]
    scales = [one for one in ("sigma_N", "phi", "gain_sd") if getattr(priors, one) != getattr(default, one)]
    nuisances = [name for name, prior in priors.calibration.items() if prior.stated]
    return (*priors.linear, *times, *scales, *nuisances)
