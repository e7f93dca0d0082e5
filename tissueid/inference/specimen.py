"""The fit of one specimen: its logs to an optimum, what they say of it, and what is to be said about it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np
from msgspec import structs
from threadpoolctl import threadpool_limits

from tissueid.arrays import FloatArray
from tissueid.documents.identification import NoiseFit, RelaxationWindow
from tissueid.documents.quantities import Quoted
from tissueid.flags import Flag
from tissueid.inference.arrival import arrived, start_flags
from tissueid.inference.engine import Identified, Request, identify_logs
from tissueid.inference.estimates import FEWEST_SLOW, TissueEstimate, estimate_tissue, slow_share
from tissueid.inference.evidence import log_evidence
from tissueid.inference.frame_effect import machine_flags
from tissueid.inference.logs import LogHandle, blocks_of, speed_handles
from tissueid.inference.quoted import EQUALLY_LONG, depth_test, quoted_numbers, with_form, with_moduli
from tissueid.inference.residual_blocks import sandwich_covariance
from tissueid.inference.rounds import ROUGH_SD, Followed, follow_surfaces, unloading_verdict, unsettled
from tissueid.inference.second_looks import relaxation_window, settled
from tissueid.inference.summaries import Known, Look, Summaries, second_pass
from tissueid.inference.system import Point
from tissueid.inference.target import SpecimenTarget
from tissueid.inference.trials import Adjustment
from tissueid.inference.unloading import unloading_disagrees, unloading_miss
from tissueid.inference.verdict import discrepancy_flags, specimen_flags
from tissueid.inference.window import FittedLog
from tissueid.inference.yardstick_law import YardstickLaw
from tissueid.measured import spread
from tissueid.measured.geometry import DEFAULT_POISSON, Geometry, TipOf
from tissueid.model.channels import DampedModel
from tissueid.model.grammar import KELVIN_VOIGT, candidates, parsed
from tissueid.model.kelvin_voigt import KEY
from tissueid.priors import Priors
from tissueid.result import ModelChoice, SpecimenFit

MAX_BRANCHES, MAX_DEGREE, MAX_STATIC = 3, 2, 3


@dataclass(frozen=True, slots=True)
class FitOptions:
    """Options of a fit.

    Attributes
    ----------
    branches : int or None
        1 to 3, or ``None`` to choose by held-out data.
    stiffness_degree : int or None
        0 to 2, or ``None`` to choose.
    static : str
        ``scaled`` (static force and K of a log in proportion, by its own curve of depth, and relaxation
        times by its own factor), ``partial`` (a gain and a contact of its own), ``shared`` (a contact of
        its own), or ``auto``: ``scaled`` where a speed was pushed at more than once, else ``partial``.
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
        Fit retracts and cycles as well, with the law of contact loss (:mod:`tissueid.inference.rounds`).
    noise : str
        ``auto``, ``white``, ``ar1`` or ``white+ar1``.
    model : str, optional
        Of the grammar of :mod:`tissueid.model.grammar`; several with ``|`` between them, or ``auto``, are
        chosen among.  None is the Kelvin-Voigt law, or what a study says.
    """

    branches: int | None = None
    stiffness_degree: int | None = None
    static: str = "auto"
    unloading: bool = False
    depths_mm: tuple[float, ...] = ()
    frequencies_Hz: tuple[float, ...] = ()
    geometry: Geometry | None = None
    poisson: float = DEFAULT_POISSON
    header_tip: bool = True
    noise: str = "auto"
    model: str | None = None

    def of_law(self, law: ModelChoice) -> FitOptions:
        """The same of a law that was chosen, its order known."""
        named = replace(self, model=law.name or law.key)
        if law.key != KELVIN_VOIGT:
            return named
        return replace(named, branches=law.branches, stiffness_degree=law.stiffness_degree)


@dataclass(frozen=True, eq=False)
class FittedSpecimen:
    """A fit with what a posterior is built from."""

    bare: SpecimenFit  # without what is quoted
    handles: tuple[LogHandle, ...]
    identified: Identified
    noise: NoiseFit
    tissue: TissueEstimate
    told: Summaries  # of the second pass over the logs
    #: What is derived from a tissue, with errors of that tissue's covariance, and flags of it.
    quoted: Callable[[TissueEstimate], tuple[Quoted, list[Flag]]] = field(repr=False)
    #: The same at another point, with other parameters and noise.
    moved: Callable[[Point], FittedSpecimen] = field(repr=False)

    @cached_property
    def fit(self) -> SpecimenFit:
        """The fit with what is quoted at its optimum."""
        return self.quoting(self.bare, self.tissue)

    def quoting(self, fit: SpecimenFit, tissue: TissueEstimate) -> SpecimenFit:
        """A fit with what is quoted of a tissue."""
        quoted, said = self.quoted(tissue) if self.identified.quotable else (None, [])
        return replace(fit, quoted=quoted, flags=(*fit.flags, *said))


def request_of(options: FitOptions, priors: Priors, *, machine: bool) -> Request:
    """Options as the engine takes them."""
    laws = candidates(options.model or KELVIN_VOIGT)
    paper = laws.paper or parsed(KELVIN_VOIGT)
    asked, degree = paper.branches or options.branches, paper.degree
    degree = options.stiffness_degree if degree is None else degree
    branches = (asked,) if asked else tuple(range(1, MAX_BRANCHES + 1))
    degrees = tuple(range(MAX_DEGREE + 1)) if degree is None else (degree,)
    return Request(branches, degrees, options.static, options.noise, priors, machine, laws)


def fit_with_state(
    specimen: str,
    handles: Sequence[LogHandle],
    *,
    options: FitOptions | None = None,
    priors: Priors | None = None,
    machine: bool = True,
    tick: Callable[[str], None] | None = None,
) -> FittedSpecimen:
    """Fit a specimen, and keep what a posterior is built from; ``machine``: it is left open."""
    options = options or FitOptions()
    tick = tick or (lambda _: None)
    # small matrices gain nothing from BLAS threads, and on a busy machine lose tenfold by them
    with threadpool_limits(limits=1, user_api="blas"):
        request = request_of(options, priors or Priors(), machine=machine)
        return _fit(specimen, list(handles), options, request, tick)


def identify_handles(
    handles: Sequence[LogHandle], request: Request, tick: Callable[[str], None]
) -> tuple[Identified, list[LogHandle]]:
    """Load the logs once, as blocks, and choose and fit their law; the same logs with what is fitted now."""
    blocks, fresh, seen = [], [], []
    for handle in handles:
        trial, log = handle.fitted()
        tick(f"reading {trial.name}")
        blocks.append(blocks_of(handle, log))
        fresh.append(replace(handle, facts=log.without_samples()))
        seen.append(log_evidence(trial, handle.segmentation, log))
    return identify_logs(blocks, [one.facts for one in fresh], seen, request, tick), fresh


def force_along(
    identified: Identified, handle: LogHandle, log: FittedLog, index: int, point: Point
) -> FloatArray:
    """Modelled force of the load channel at every sample of one log, (n,) [N]."""
    blocks = blocks_of(handle, log, whole=True)
    system, own = identified.system.alone(blocks, index, point)
    force = system.recorded(system.tip_force(own)[0], own.machine)
    return np.asarray(force[np.searchsorted(blocks.time_s, log.data.time_s)])


def adjustments_of(identified: Identified, handles: Sequence[LogHandle], point: Point) -> list[Adjustment]:
    """Gain, contact and relaxation of every log."""
    system = identified.system
    offsets = (system.offsets(point) * system.depth_mm).tolist()
    effects, ones = system.effects, [1.0] * len(handles)
    gains = np.exp(point.own[:, 0]).tolist() if effects.gain else ones
    times = np.exp(point.own[:, effects.time_at]).tolist() if effects.time else ones
    return [
        Adjustment(gain, offset, handle.contact_shift_mm, time)
        for gain, offset, handle, time in zip(gains, offsets, handles, times, strict=True)
    ]


def noise_of(identified: Identified, worth: float) -> NoiseFit:
    """The noise as it is told."""
    found = identified.optimum.noise
    step = min(float(np.median(one.step_s)) for one in identified.system.logs)
    kind: Literal["white", "ar1", "white+ar1"] = "white"
    if found.memory.time_s > 0.0:
        kind = "white+ar1" if found.memory.white > 0.0 else "ar1"
    phi = found.memory.phi(step)
    return NoiseFit(
        model=kind,
        sigma_N=found.sigma_N,
        phi=phi,
        reference_step_s=step,
        moving_average=_moving_average(phi, found.memory.white),
        measured_N=identified.verdict.measured_N or None,
        samples_per_independent=max(worth, 1.0 + 1e-9) if identified.discrepant else 1.0,
    )


def _moving_average(phi: float, white: float) -> float:
    """Theta of e_n = r_n - phi r_(n-1) + theta e_(n-1) of an AR(1) beside white noise."""
    if white <= 0.0 or phi <= 0.0:
        return 0.0
    # autocovariances of r_n - phi r_(n-1): 1 + phi^2 - 2 phi (1 - w) phi, and -phi w
    zero, one = 1.0 + phi * phi - 2.0 * phi * phi * (1.0 - white), phi * white
    half = zero / (2.0 * one)
    return float(half - np.sqrt(max(half * half - 1.0, 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """Whatever a specimen's fit has found, to be described at any point near its optimum."""

    specimen: str
    handles: tuple[LogHandle, ...]
    identified: Identified
    followed: Followed | None
    optimisers: dict[str, Any]
    tissue: TissueEstimate
    noise: NoiseFit
    window: RelaxationWindow | None
    options: FitOptions
    tick: Callable[[str], None]
    moved: tuple[Flag, ...] = ()  # numbers that unloading moves

    @property
    def facts(self) -> list[FittedLog]:
        """Facts of the fitted part of each log."""
        return [one.facts for one in self.handles]

    def at(self, point: Point, looks: Sequence[Look] = ()) -> FittedSpecimen:
        """The fit as it is told with the tissue of a point; ``looks``: at its recordings, from another."""
        found, theta = self.identified, self.identified.law.theta(point.log_times, point.linear)[0]
        here = replace(self.tissue, theta=theta)
        adjustments = adjustments_of(found, self.handles, point)
        tip = TipOf(self.options.geometry, self.options.header_tip)
        told = second_pass(
            self.handles,
            adjustments,
            Known(here, self.noise, self.options.depths_mm, tip),
            self.tick,
            force_of=lambda i, log: force_along(found, self.handles[i], log, i, point),
            looks=looks,
        )
        flags, unloading, missed = (*self._flags(here, told, point), *self.moved), None, None
        if self.followed is None or not self.options.unloading:
            missed = unloading_miss(found, self.handles, point)
            flags = (*flags, *unsettled(self.followed))
        else:
            unloading, more = unloading_verdict(self.followed, here, adjustments, sigma_N=self.noise.sigma_N)
            flags = (*flags, *more)
        numbers, flags = self._told(here, told), _one_form(flags)
        fit = replace(numbers, flags=flags, unloading=unloading, unloading_predicted=missed)
        moved, quoted = partial(self.at, looks=told.looks), partial(self._quoted, told)
        return FittedSpecimen(fit, self.handles, found, self.noise, here, told, quoted, moved)

    def _flags(self, here: TissueEstimate, told: Summaries, point: Point) -> tuple[Flag, ...]:
        """Everything that is to be said of the fit itself."""
        found, noise, request = self.identified, self.noise, self.identified.request
        force, depth = float(np.abs(found.system.force).max()), found.system.depth_mm
        priors, own = request.priors.calibration, tuple[Flag, ...]()
        if found.quotable:
            own = specimen_flags(
                here, self.facts, told.trials, sigma_N=noise.sigma_N, optimisers=self.optimisers,
                noise=None if noise.discrepant else noise.model,
            )  # fmt: skip
        return (
            *discrepancy_flags(noise, told.nrmsd),
            *own,
            *undecided_flags(found),
            *rival_flags(found),
            *bent_flags(found),
            *window_flags(self.window),
            *damping_flags(found, here),
            *(machine_flags(point.machine, priors, force_N=force, depth_mm=depth) if request.machine else ()),
            *start_flags(found, self.handles),
        )

    def _quoted(self, told: Summaries, tissue: TissueEstimate) -> tuple[Quoted, list[Flag]]:
        """Numbers that are derived from a tissue, with errors of its covariance, and flags of them."""
        geometry = self.options.geometry
        slope, drains = depth_test(geometry, *_equal_holds(told))
        step, length = min(log.step_s for log in self.facts), max(log.duration_s for log in self.facts)
        frequencies = self.options.frequencies_Hz
        holds = [one.holds for one in told.looks]
        plain = quoted_numbers(tissue, holds, step_s=step, duration_s=length, frequencies_Hz=frequencies)
        numbers, said = with_moduli(with_form(plain, self.identified.rivals), tissue, geometry)
        if slope is None:
            return numbers, said
        decided = slope.at.verdict in {"viscous", "drainage"}
        kept = [flag for flag in said if not (decided and flag.code == "poroelastic")]
        return structs.replace(numbers, model=(*numbers.model, slope)), [*kept, *drains]

    def _told(self, here: TissueEstimate, told: Summaries) -> SpecimenFit:
        """The numbers of the fit; what is quoted and to be said of them is added."""
        found, speeds = self.identified, [one for log in self.facts for one in log.speeds_mm_s if one > 0.0]
        return SpecimenFit(
            specimen=self.specimen,
            model=_choice_of(found, here, "shared" if len(self.handles) == 1 else found.request.pooling),
            parameters=here.parameters,
            theta_names=here.model.parameter_names,
            theta=here.theta,
            covariance=here.covariance,
            depth_mm=found.depth_mm,
            speeds_mm_s=(min(speeds, default=0.0), max(speeds, default=0.0)),
            tip_radius_mm=None,
            sigma_N=self.noise.sigma_N,
            n_samples=found.system.samples,
            nrmsd=told.nrmsd,
            trials=told.trials,
            relaxation=tuple(row for one in told.looks for row in one.relaxation),
            relaxation_window=self.window,
            optimisers=self.optimisers,
            selection=found.table,
            cycles=told.cycles,
            measured=spread([trial.measured for trial in told.trials if trial.measured is not None]),
        )


def _choice_of(found: Identified, tissue: TissueEstimate, pooling: str) -> ModelChoice:
    """The model that was chosen, as files name it."""
    law, asked = found.law.model_of, found.request.candidates.paper
    # as it was asked for, or as it was chosen
    paper = KELVIN_VOIGT if asked is None else asked.name
    nodes: dict[str, Any] = {}
    if isinstance(found.law, YardstickLaw):
        nodes = {"inside_s": found.law.mark.inside_s, "outside_s": found.law.mark.outside_s}
    return ModelChoice(
        key=KEY if law is None else law.name,
        name=paper if law is None else law.name,
        branches=tissue.model.branches,
        static_degree=min(found.law.static_size, MAX_STATIC),
        stiffness_degree=found.law.degree,
        static_pooling=pooling,
        range_s=None if law is None else (law.resolution_s, law.window_s),
        **nodes,
    )


def _fit(
    specimen: str,
    handles: list[LogHandle],
    options: FitOptions,
    request: Request,
    tick: Callable[[str], None],
) -> FittedSpecimen:
    """Identify a specimen, and describe it at its optimum."""
    followed: Followed | None = None
    loading, identify = handles, partial(identify_handles, request=request, tick=tick)
    if options.unloading:
        first = identify([replace(one, unloading=True) for one in handles])
        followed = follow_surfaces(*first, identify, tick)
    else:
        identified, handles = identify(speed_handles(handles, request.candidates))
        identified, handles = arrived(identified, handles, partial(_again, request, tick), tick)
        if identified.law.model_of is None and any(one.facts.tool_mm is not None for one in handles):
            followed = _remembered(identified, handles, tick)
    if followed is not None:
        identified, handles = followed.identified, followed.handles
    tick("Levenberg-Marquardt")
    identified, optimisers = settled(identified)
    tissue = estimate_tissue(identified)
    worth = _worth(identified)
    relaxes = identified.quotable and tissue.model.branches > 0
    found = _Found(
        specimen=specimen,
        handles=tuple(handles),
        identified=identified,
        followed=followed,
        optimisers=optimisers,
        tissue=tissue,
        noise=noise_of(identified, worth),
        window=relaxation_window(handles, identified, tick) if relaxes else None,
        options=options,
        tick=tick,
        moved=_moved_by_unloading(loading, identified, tick) if options.unloading else (),
    )
    return found.at(identified.optimum.point)


def _again(
    request: Request, tick: Callable[[str], None], handles: Sequence[LogHandle], like: Identified | None
) -> tuple[Identified, list[LogHandle]]:
    """Logs identified as requested, or in the order of another fit alone."""
    if like is not None:
        request = replace(request, branches=(like.law.branches,), degrees=(like.law.degree,))
    return identify_handles(handles, request, tick)


#: Contact sd by which a fit moves a contact that then has set; orders that are chosen on surfaces found.
SET_SD, ORDERS = 3.0, 2


def _remembered(
    found: Identified, handles: list[LogHandle], tick: Callable[[str], None], again: int = ORDERS
) -> Followed:
    """Tests after loops that let go, on the surface that comes back in between under the law found.

    A contact that the fit moves far from where it was first met has set: its prior is widened.  The order is
    chosen again on the surface found.
    """
    law, identify = found.law, partial(_again, found.request, tick, like=found)
    followed = follow_surfaces(found, handles, identify, tick)
    at = adjustments_of(followed.identified, handles, followed.identified.optimum.point)
    met = [(one, one.segmentation.contact) for one in handles]
    wide = [replace(one, contact_sd_mm=contact.sd_mm) for one, contact in met if contact is not None]
    known = [(one.contact_sd_mm, new.contact_sd_mm) for one, new in zip(handles, wide, strict=True)]
    far = [abs(one.contact_offset_mm) / SET_SD for one in at]
    if any(tight < min(by, sd) for by, (tight, sd) in zip(far, known, strict=True)):
        return _remembered(*identify_handles(wide, found.request, tick), tick)
    chosen, on = identify_handles(followed.handles, found.request, tick)
    if again and chosen.law.order != law.order:
        other = _remembered(chosen, on, tick, again - 1)
        if other.change_sd < ROUGH_SD or followed.change_sd >= ROUGH_SD:
            return other
    same = replace(followed.identified, table=chosen.table, as_good=chosen.as_good, rivals=chosen.rivals)
    return replace(followed, identified=same)


def _worth(found: Identified) -> float:
    """Samples that count as an independent one where the law misses more than the noise."""
    if not (found.discrepant and found.quotable):
        return 1.0
    return sandwich_covariance(SpecimenTarget(found, machine=found.request.machine))[1]


def _moved_by_unloading(
    handles: Sequence[LogHandle], whole: Identified, tick: Callable[[str], None]
) -> tuple[Flag, ...]:
    """Flag of numbers that a fit of loading and holds in the same order has elsewhere."""
    tick("loading and holds alone")
    if any(handle.own_window(handle.load()) is None for handle in handles):
        return ()
    loaded, _ = _again(whole.request, tick, handles, whole)
    return unloading_disagrees(loaded, whole, _worth(loaded))


def _equal_holds(told: Summaries) -> tuple[list[float], list[float]]:
    """Depths and times of drainage of the longest hold of each log, of holds as long as the longest."""
    holds = [one.holds for one in told.looks]
    most = max((one.longest_s for one in holds), default=0.0)
    known = [one for one in holds if one.drainage_s > 0.0 and one.longest_s >= EQUALLY_LONG * most]
    return [one.depth_mm for one in known], [one.drainage_s for one in known]


def window_flags(window: RelaxationWindow | None) -> tuple[Flag, ...]:
    """A relaxation time that follows the hold it was shown."""
    if window is None or not window.effective:
        return ()
    first, last = (f"{window.tau_s[k]:.3g} s in {window.cut_s[k]:.3g} s" for k in (-1, 0))
    words = f"one relaxation time follows the hold: {first}, {last}"
    return (Flag("form_dependent", words, {"slope": window.slope}),)


def _one_form(flags: tuple[Flag, ...]) -> tuple[Flag, ...]:
    """Flags with one remark on the form of the law: by another law, else the window, else the program."""
    forms = [flag for flag in flags if flag.code == "form_dependent"]
    for key in ("gain", "slope", "depth_mm"):
        told = [flag for flag in forms if key in flag.values]
        if told:
            return tuple(flag for flag in flags if flag not in forms or flag is told[0])
    return flags


def rival_flags(identified: Identified) -> tuple[Flag, ...]:
    """The law that predicts better, or as well with another relaxation time."""
    worth = [one for one in identified.rivals if one.better or one.disagrees]
    if not worth:
        return ()
    most = max(one.gain for one in worth)
    # they stand in the order of their branches
    best = next(one for one in worth if one.gain >= most - one.stderr)
    closer = 100.0 * (1.0 - float(np.exp(-0.5 * best.gain)))
    how = f"{closer:.0f} % closer" if best.better else "as well"
    words = f"{best.name} predicts a left-out {identified.left_out} {how}"
    values = {"gain": best.gain, "stderr": best.stderr}
    if np.isfinite(best.tau_s):
        words, values = f"{words}, with tau {best.tau_s:.3g} s", values | {"tau_s": best.tau_s}
    return (Flag("form_dependent", words, values),)


def bent_flags(identified: Identified) -> tuple[Flag, ...]:
    """F_s and K that one speed and depth part by the constancy of K alone."""
    bent = identified.bent
    if bent is None:
        return ()
    (low, high), known = bent.ends_N, f"{bent.force_N:.3g}"
    force = f"F_s at {bent.depth_mm:.3g} mm"
    words = f"were K linear in depth, {force} could be {low:.3g} to {high:.3g} N (constant: {known})"
    values = {"depth_mm": bent.depth_mm, "force_N": bent.force_N, "low_N": low, "high_N": high}
    return (Flag("split_assumed", words, values),)


def damping_flags(identified: Identified, tissue: TissueEstimate) -> tuple[Flag, ...]:
    """Static force and damping that are one number: no sample is slow."""
    model = tissue.model
    if not isinstance(model, DampedModel) or (share := slow_share(identified)) >= FEWEST_SLOW:
        return ()
    spec, value = model.parameters[0], model.loading_stiffness(tissue.theta)
    known = f"only {spec.symbol} (1 + chi) = {value:.4g} {spec.unit} is known"
    words = f"{known}: {100.0 * share:.2g} % of samples are slow"
    return (Flag("one_speed_ratio", words, {"slow_share": share, "loading": value}),)


def undecided_flags(identified: Identified) -> tuple[Flag, ...]:
    """Other orders that predict what was left out as well as the chosen one."""
    others = [one for one in identified.as_good if one != identified.law.order]
    if not others:
        return ()
    orders = [f"{b}x{d}" for b, d in others]
    listed = f"{', '.join(orders[:3])} (branches x degree)"
    words = f"a left-out {identified.left_out} is predicted as well by {listed}"
    return (Flag("model_undecided", words, {"orders": orders}),)
