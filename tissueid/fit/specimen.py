"""Fit one specimen: sums, model choice, both optimisers, estimates, and what each trial says of it.

Logs are loaded through callables, twice at the most and one at a time, so that memory does not grow
with a study: once for their sums, once for residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tissueid.fit.agreement import both_optimisers
from tissueid.fit.candidates import Candidate, Solution, SpecimenSums, fit_candidate, sum_of_logs
from tissueid.fit.estimates import TissueEstimate, estimate_tissue, in_field_units
from tissueid.fit.logs import LogHandle, refine_contacts, specimen_sums
from tissueid.fit.material import with_moduli
from tissueid.fit.one_log_choice import choose_for_one_log
from tissueid.fit.quoted import quoted_numbers
from tissueid.fit.relaxation_window import relaxation_window
from tissueid.fit.rounds import Followed, follow_surfaces, unloading_handles, unloading_verdict
from tissueid.fit.search import unbounded_covariance
from tissueid.fit.selection import Choice, choose
from tissueid.fit.settling import settle_choice, undecided_flags
from tissueid.fit.summaries import Summaries, second_pass
from tissueid.fit.trials import Adjustment
from tissueid.fit.verdict import discrepancy_flags, one_program, specimen_flags
from tissueid.fit.whitening import Whitened, optimum_of, whiten
from tissueid.likelihood.linearise import Optimum
from tissueid.likelihood.sums import N_STATIC, reduction
from tissueid.measured import spread
from tissueid.measured.geometry import DEFAULT_POISSON, Geometry, TipOf
from tissueid.model.kelvin_voigt import KEY, STATIC_DEGREE, KelvinVoigt
from tissueid.quantities import RelaxationWindow
from tissueid.result import ModelChoice, SpecimenFit

__all__ = [
    "FitOptions",
    "FittedSpecimen",
    "LogHandle",
    "adjustments_of",
    "fit_specimen",
    "fit_with_state",
]

FloatArray = NDArray[np.float64]

MAX_BRANCHES = 3
MAX_DEGREE = 2
#: Branches of the model that contact points are refined with, where more than one may be chosen.
REFINING_BRANCHES = 2
#: Samples from which one branch is fitted in two passes, samples of the first, half width of the range
#: of ln tau in the second, and the standard errors of ln tau that must fit into it.
FOCUS_FROM = 100_000
THINNED_TO = 50_000
FOCUS = 0.4
FOCUS_SD = 6.0


@dataclass(frozen=True, slots=True)
class FitOptions:
    """What a user may ask of a fit.

    Attributes
    ----------
    branches : int or None
        1 to 3, or ``None`` to choose by held-out data.
    stiffness_degree : int or None
        0 to 2, or ``None`` to choose.
    static : str
        ``partial`` (default), ``shared`` or ``per-log``.
    depths_mm : tuple of float
        Depths below contact at which the stiffness of each loop is wanted.
    frequencies_Hz : tuple of float
        At which moduli and losses are quoted; none takes the usual ones the data support.
    geometry : Geometry or None
        Tip (and thickness) of this specimen, for its moduli.
    poisson : float
        Poisson's ratio where a study gives the tip.
    header_tip : bool
        Take the tip of a recording's header where there is no geometry.
    unloading : bool
        Fit retracts and cycles as well, with the law of contact loss (:mod:`tissueid.fit.rounds`).
    noise : str
        ``auto``, ``white``, ``ar1`` or ``white+ar1``.
    """

    branches: int | None = None
    stiffness_degree: int | None = None
    static: str = "partial"
    unloading: bool = False
    depths_mm: tuple[float, ...] = ()
    frequencies_Hz: tuple[float, ...] = ()
    geometry: Geometry | None = None
    poisson: float = DEFAULT_POISSON
    header_tip: bool = True
    noise: str = "auto"


@dataclass(frozen=True, slots=True, eq=False)
class FittedSpecimen:
    """A fit with what a posterior is built from.

    Attributes
    ----------
    fit : SpecimenFit
    handles : tuple of LogHandle
    whitened : Whitened
        Noise, sums with correlated noise, and the solution under them.
    optimum : Optimum
        That solution as the point of linearisation.
    tissue : TissueEstimate
    adjustments : tuple of Adjustment
        One a log.
    told : Summaries
        Of the second pass over the logs.
    moved : callable
        The same of another tissue and other adjustments, for the same sums.
    """

    fit: SpecimenFit
    handles: tuple[LogHandle, ...]
    whitened: Whitened
    optimum: Optimum
    tissue: TissueEstimate
    adjustments: tuple[Adjustment, ...]
    told: Summaries
    moved: Callable[[TissueEstimate, Sequence[Adjustment]], FittedSpecimen]


def adjustments_of(
    sums: SpecimenSums,
    solution: Solution,
    tissue: tuple[KelvinVoigt, FloatArray],
    handles: Sequence[LogHandle],
) -> list[Adjustment]:
    """Gain, offset or own static curve of every log."""
    found = solution.evaluation
    if solution.candidate.pooling == "partial":
        return [
            Adjustment(
                gain=float(np.exp(gamma)),
                contact_offset_mm=float(delta),
                contact_shift_mm=handle.contact_shift_mm,
            )
            for gamma, delta, handle in zip(found.gamma, found.delta, handles, strict=True)
        ]
    if solution.candidate.pooling == "shared":
        return [Adjustment() for _ in handles]
    gram = sum_of_logs(sums)[None] if sums.single else sums.gram
    candidate = solution.candidate
    weights = reduction(
        sums.basis, found.log_tau, degree=candidate.degree, columns_degree=sums.columns_degree
    )
    model, theta = tissue
    _, stiffness, _ = model.split(theta)
    used = N_STATIC + stiffness.size
    out = []
    for one in gram:
        q = weights.T @ one @ weights
        rest = q[:N_STATIC, -1] - q[:N_STATIC, N_STATIC:used] @ stiffness.ravel()
        unit = 1.0 / np.sqrt(np.maximum(np.diag(q)[:N_STATIC], 1e-300))
        own = np.linalg.lstsq(q[:N_STATIC, :N_STATIC] * unit[:, None] * unit, rest * unit, rcond=1e-12)[0]
        out.append(Adjustment(static=own * unit))
    return out


def _pooling(options: FitOptions, logs: int) -> str:
    """One log has nothing to pool: its gain is the tissue's."""
    return "shared" if logs == 1 and options.static == "partial" else options.static


def _focused(
    handles: Sequence[LogHandle], candidate: Candidate, tick: Callable[[str], None]
) -> tuple[SpecimenSums, Choice] | None:
    """Many samples, one branch: a thinned pass finds tau, a second sums all samples near it only.

    ``None`` where the samples are few, or where the interval of tau is not well inside that range.
    """
    samples = sum(handle.facts.n_samples for handle in handles)
    if candidate.branches != 1 or samples < FOCUS_FROM or len(handles) == 1:
        return None
    rough = specimen_sums(handles, candidate.degree, tick, thin=samples // THINNED_TO)
    at = float(fit_candidate(rough, candidate).evaluation.log_tau[0])
    low, high = rough.log_tau_bounds
    near = max(at - FOCUS, low), min(at + FOCUS, high)
    sums = specimen_sums(handles, candidate.degree, tick, log_range=near)
    solution = fit_candidate(sums, candidate, seeds=[np.array([at])])
    found = solution.evaluation
    inverse, _ = unbounded_covariance(found, solution.objective.blocks)
    margin = FOCUS_SD * float(np.sqrt(inverse[-1, -1] * solution.noise.sigma2))
    inside = near[0] + margin < found.log_tau[0] < near[1] - margin
    return (sums, Choice(solution=solution, table=())) if inside else None


def _sums_and_choice(
    handles: Sequence[LogHandle],
    branches: tuple[int, ...],
    degrees: tuple[int, ...],
    pooling: str,
    tick: Callable[[str], None],
) -> tuple[SpecimenSums, Choice]:
    if len(branches) == len(degrees) == 1:
        focused = _focused(handles, Candidate(branches[0], degrees[0], pooling), tick)
        if focused is not None:
            return focused
    sums = specimen_sums(handles, max(degrees), tick)
    one_speed = one_program([handle.facts for handle in handles])
    look = choose_for_one_log if len(handles) == 1 else choose
    choice = look(
        sums, branches=branches, degrees=degrees, pooling=pooling, one_speed=one_speed, progress=tick
    )
    return sums, choice


def fit_specimen(
    specimen: str,
    handles: Sequence[LogHandle],
    *,
    options: FitOptions | None = None,
    tick: Callable[[str], None] | None = None,
) -> SpecimenFit:
    """Identify the contact model of one specimen from its logs.

    Parameters
    ----------
    specimen : str
    handles : sequence of LogHandle
        At least one.
    options : FitOptions, optional
    tick : callable, optional
        Told what is being done.

    Returns
    -------
    SpecimenFit
    """
    return fit_with_state(specimen, handles, options=options, tick=tick).fit


def fit_with_state(
    specimen: str,
    handles: Sequence[LogHandle],
    *,
    options: FitOptions | None = None,
    tick: Callable[[str], None] | None = None,
) -> FittedSpecimen:
    """As :func:`fit_specimen`, with what a posterior is built from."""
    options = options or FitOptions()
    tick = tick or (lambda _: None)
    # small matrices gain nothing from BLAS threads, and on a busy machine lose tenfold by them
    with threadpool_limits(limits=1, user_api="blas"):
        return _fit(specimen, list(handles), options, tick)


def _refined(
    handles: list[LogHandle],
    options: FitOptions,
    branches: tuple[int, ...],
    degrees: tuple[int, ...],
    tick: Callable[[str], None],
) -> list[LogHandle]:
    """Contact points moved to where a first fit puts them."""
    if options.static != "partial" or (options.unloading and len(handles) == 1):
        return handles
    # at one speed a K that varies with depth would bend instead of the contact moving
    degree = min(degrees) if one_program([handle.facts for handle in handles]) else min(1, max(degrees))
    flexible = Candidate(branches=min(REFINING_BRANCHES, max(branches)), degree=degree, pooling="partial")
    return refine_contacts(handles, flexible, tick)


def _under_its_noise(
    handles: Sequence[LogHandle],
    sums: SpecimenSums,
    solution: Solution,
    options: FitOptions,
    tick: Callable[[str], None],
) -> Whitened:
    """The fit finished under the noise that its residuals show."""
    model, theta, _, _, _ = in_field_units(sums, solution)
    adjustments = adjustments_of(sums, solution, (model, theta), handles)
    return whiten(handles, sums, solution, model, theta, adjustments, tick, noise=options.noise)


def _settled(
    handles: Sequence[LogHandle],
    sums: SpecimenSums,
    choice: Choice,
    asked: tuple[tuple[int, ...], tuple[int, ...]],
    options: FitOptions,
    tick: Callable[[str], None],
) -> tuple[Whitened, Choice]:
    """The fit under its noise, and the choice of ``asked`` branches and degrees made again under it."""
    whitened = _under_its_noise(handles, sums, choice.solution, options, tick)
    # of one log, what a model lacks can't be told from noise with memory: its choice stands
    if choice.candidates and not options.unloading and len(handles) > 1:
        choice, settled = settle_choice(sums, whitened, choice, handles, asked, tick)
        if settled.candidate != whitened.solution.candidate:
            whitened = _under_its_noise(handles, sums, settled, options, tick)
    return whitened, choice


def _fit(
    specimen: str, handles: list[LogHandle], options: FitOptions, tick: Callable[[str], None]
) -> FittedSpecimen:
    branches = (options.branches,) if options.branches else tuple(range(1, MAX_BRANCHES + 1))
    degrees = (
        tuple(range(MAX_DEGREE + 1)) if options.stiffness_degree is None else (options.stiffness_degree,)
    )
    pooling = _pooling(options, len(handles))
    if options.unloading:
        handles = unloading_handles(handles)
    handles = _refined(handles, options, branches, degrees, tick)

    def choice_for(current: Sequence[LogHandle]) -> tuple[SpecimenSums, Choice]:
        return _sums_and_choice(current, branches, degrees, pooling, tick)

    followed = None
    if options.unloading:
        followed = follow_surfaces(handles, choice_for, tick)
        handles, sums, choice = followed.handles, followed.sums, followed.choice
    else:
        sums, choice = choice_for(handles)
    whitened, choice = _settled(handles, sums, choice, (branches, degrees), options, tick)
    sums = whitened.sums
    solution, optimisers = both_optimisers(sums, whitened.solution)
    tissue = estimate_tissue(sums, solution)
    adjustments = adjustments_of(sums, solution, (tissue.model, tissue.theta), handles)
    fitting = _Fitting(
        specimen=specimen,
        handles=tuple(handles),
        whitened=replace(whitened, solution=solution),
        choice=choice,
        followed=followed,
        optimisers=optimisers,
        window=relaxation_window(handles, solution.candidate, tick),
        options=options,
    )
    return _described(fitting, tissue, adjustments, tick)


@dataclass(frozen=True, slots=True, eq=False)
class _Fitting:
    """All that a description of a specimen needs beside its tissue."""

    specimen: str
    handles: tuple[LogHandle, ...]
    whitened: Whitened
    choice: Choice
    followed: Followed | None
    optimisers: dict[str, object]
    window: RelaxationWindow | None
    options: FitOptions


def _described(
    fitting: _Fitting,
    tissue: TissueEstimate,
    adjustments: Sequence[Adjustment],
    tick: Callable[[str], None],
) -> FittedSpecimen:
    """What a specimen's logs say of a tissue: residuals, quoted numbers, flags."""
    options, whitened, handles, choice = fitting.options, fitting.whitened, fitting.handles, fitting.choice
    sums, solution, followed = whitened.sums, whitened.solution, fitting.followed
    told = second_pass(
        handles,
        adjustments,
        tissue,
        tick,
        noise=whitened.noise,
        tempering=whitened.tempering,
        depths_mm=options.depths_mm,
        tip=TipOf(options.geometry, options.header_tip),
    )
    sigma = whitened.noise.sigma_N
    facts = [handle.facts for handle in handles]
    flags = specimen_flags(
        tissue,
        sums,
        facts,
        told.trials,
        sigma_N=sigma,
        optimisers=fitting.optimisers,
        noise=None if whitened.noise.discrepant else whitened.noise.model,
    )
    flags = (*discrepancy_flags(whitened.noise, told.nrmsd), *flags)
    quoted = quoted_numbers(
        tissue,
        told.holds,
        step_s=sums.step_s,
        duration_s=sums.duration_s,
        frequencies_Hz=options.frequencies_Hz,
    )
    quoted, said = with_moduli(quoted, tissue, options.geometry)
    flags = (*flags, *undecided_flags(choice), *said)
    unloading = None
    if followed is not None:
        unloading, more = unloading_verdict(followed, tissue, adjustments, sigma_N=sigma)
        flags = (*flags, *more)
    speeds = [speed for log in facts for speed in log.speeds_mm_s if speed > 0.0] or [0.0]
    fit = SpecimenFit(
        specimen=fitting.specimen,
        model=ModelChoice(
            key=KEY,
            branches=solution.candidate.branches,
            static_degree=STATIC_DEGREE,
            stiffness_degree=solution.candidate.degree,
            static_pooling=solution.candidate.pooling,
        ),
        parameters=tissue.parameters,
        theta_names=tissue.model.parameter_names,
        theta=tissue.theta,
        covariance=tissue.covariance,
        depth_mm=sums.depth_mm,
        speeds_mm_s=(min(speeds), max(speeds)),
        tip_radius_mm=None,
        sigma_N=sigma,
        n_samples=sums.n,
        nrmsd=told.nrmsd,
        trials=told.trials,
        relaxation=told.relaxation,
        relaxation_window=fitting.window,
        optimisers=fitting.optimisers,
        selection=choice.table,
        flags=flags,
        unloading=unloading,
        cycles=told.cycles,
        measured=spread([trial.measured for trial in told.trials if trial.measured is not None]),
        quoted=quoted,
    )
    return FittedSpecimen(
        fit=fit,
        handles=handles,
        whitened=whitened,
        optimum=optimum_of(solution, adjustments, sums.depth_mm),
        tissue=tissue,
        adjustments=tuple(adjustments),
        told=told,
        moved=lambda elsewhere, changes: _described(fitting, elsewhere, changes, tick),
    )
