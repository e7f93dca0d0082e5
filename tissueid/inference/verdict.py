"""Flags of a fitted specimen: what its numbers can't carry, each with the number that says so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tissueid.documents.identification import MisfitAlarm, NoiseFit
from tissueid.flags import Flag
from tissueid.inference.estimates import VISCOSITY, TissueEstimate
from tissueid.inference.window import FittedLog, one_program, one_speed
from tissueid.measured.relaxation import WINDOW_SHARE
from tissueid.result import Estimate, Nrmsd, SpecimenFit, TrialFit
from tissueid.uncertainty import ParameterUncertainty, Posterior

#: Relaxation times below this are moved by unstated force filters and time skew [s].
INSTRUMENT_TAU_S = 0.2
CORRELATED = 0.5
#: Depths at which the force of a branch is looked at.
DEPTHS = 65
#: Symbols named in one sentence.
LONGEST_LIST = 4


def _listed(symbols: Sequence[str], of: int) -> str:
    """``eta, tau (2 of 6)``: the first few of a list, and how many there are."""
    shown = ", ".join(symbols[:LONGEST_LIST])
    return f"{shown}{', ...' if len(symbols) > LONGEST_LIST else ''} ({len(symbols)} of {of} parameters)"


def _relaxing_N(tissue: TissueEstimate, branch: int, log: FittedLog) -> float:
    """Largest force of a branch on a ramp to the depth of a log [N]; K may fall towards its end."""
    depth = np.linspace(0.0, log.depth_mm, DEPTHS)
    length = max(log.speeds_mm_s) * float(tissue.model.times(tissue.theta)[branch])
    if length <= 0.0:
        return 0.0
    state = -length * np.expm1(-depth / length)
    return float(np.max(tissue.model.stiffness(tissue.theta, depth)[branch] * state))


def _relaxation_flags(tissue: TissueEstimate, facts: Sequence[FittedLog], sigma_N: float) -> list[Flag]:
    flags = []
    tau = tissue.model.times(tissue.theta)
    h, seen_s = min(log.step_s for log in facts), max(log.duration_s for log in facts)
    for j, interval in enumerate(tissue.intervals):
        value = float(tau[j])
        if interval.closed and value > WINDOW_SHARE * seen_s:
            words = f"relaxation time {j + 1} is {value:.3g} s, over a third of the {seen_s:.3g} s seen"
            values = {"branch": j + 1, "tau_s": value, "window_length_s": seen_s}
            flags.append(Flag("tau_exceeds_window", words, values))
        if interval.open_low or interval.open_high:
            side, end = ("shortest", interval.low) if interval.open_low else ("longest", interval.high)
            words = f"interval of relaxation time {j + 1} meets {np.exp(end):.3g} s, the {side} seen here"
            ends = {"low_s": float(np.exp(interval.low)), "high_s": float(np.exp(interval.high))}
            flags.append(Flag("interval_open", words, {"branch": j + 1, **ends}))
        if value < 2.0 * h:
            words = f"relaxation time {j + 1} is {value:.3g} s, under two sampling intervals of {h:.3g} s"
            flags.append(Flag("tau_below_resolution", words, {"branch": j + 1, "tau_s": value, "step_s": h}))
        amplitude = max(_relaxing_N(tissue, j, log) for log in facts)
        need = 3.0 * sigma_N * float(np.sqrt(8.0 * h / value))
        if amplitude < need:
            words = f"relaxation {j + 1} moves {amplitude:.3g} N at most; to time it takes {need:.3g} N"
            values = {"branch": j + 1, "amplitude_N": amplitude, "needed_N": need}
            flags.append(Flag("amplitude_small", words, values))
    shortest = float(tau.min(initial=np.inf))
    if shortest < INSTRUMENT_TAU_S:
        words = f"{shortest:.3g} s may be a force filter's, a time skew's or the frame's: none is stated"
        flags.append(Flag("compliance_unknown", words, {"tau_s": shortest}))
    return flags


def _form_flag(tissue: TissueEstimate, facts: Sequence[FittedLog]) -> list[Flag]:
    model = tissue.model
    if model.stiffness_degree == 0 or not one_program(facts):
        return []
    depth = model.depth_mm
    stiffness = model.stiffness(tissue.theta, np.array([depth]))[:, 0]
    viscosity = float(stiffness @ model.times(tissue.theta))
    words = f"one speed, one depth: short of {depth:.3g} mm polynomials alone part F_s from K"
    return [Flag("form_dependent", words, {"depth_mm": depth, "viscosity_N_s_per_mm": viscosity})]


def _optimum_flags(tissue: TissueEstimate, optimisers: dict[str, object]) -> list[Flag]:
    """Flags of the optimum itself: bounds, uniqueness after contact loss, the second optimiser."""
    flags: list[Flag] = []
    if tissue.bounded:
        words = f"F_s or K touches zero within {tissue.model.depth_mm:.3g} mm: the passivity bound"
        flags.append(Flag("bound_active", words))
    if not tissue.model.contact_loss_is_unique(tissue.theta):
        fitted = f"fitted to {tissue.model.depth_mm:.3g} mm"
        words = f"{fitted}, the free surface has several positions after contact loss"
        flags.append(Flag("contact_loss_ambiguous", words))
    if optimisers["agree"] is False:
        apart = optimisers["relative_difference"]
        words = f"two optimisers ended apart by {apart:.2g} of the misfit; the better was kept"
        flags.append(Flag("optimisers_disagree", words, {"relative_difference": apart}))
    if not optimisers["lm_converged"] and not tissue.bounded:
        count = len(tissue.parameters)
        flags.append(Flag("not_converged", f"Levenberg-Marquardt did not converge on {count} parameters"))
    return flags


#: A residual below so many times the noise is refuted by its correlation, not by its size.
OF_ITS_SIZE = 1.1
#: Misfit over the range of the force below which arithmetic alone is left, as of a log without any noise.
ROUNDING = 1e-6


def discrepancy_flags(noise: NoiseFit, nrmsd: Nrmsd) -> list[Flag]:
    """Flags of a misfit that exceeds the noise of the recordings, and rounding."""
    if not noise.discrepant or nrmsd.range < ROUNDING:
        return []
    measured = noise.measured_N or 0.0
    ratio = noise.sigma_N / measured if measured > 0.0 else None
    times = "far above the noise" if ratio is None else f"{ratio:.2g} times the noise"
    if ratio is not None and ratio < OF_ITS_SIZE:
        times = "as correlated noise would"
    missed = f"{noise.sigma_N:.2g} N ({100.0 * nrmsd.range:.2g} % of its range)"
    words = f"the model misses the force by {missed}, {times}"
    values = {"rms_N": noise.sigma_N, "measured_N": measured, "ratio": ratio}
    return [Flag("discrepancy", words, values | {"samples_per_independent": noise.samples_per_independent})]


def unidentified(parameters: Sequence[Estimate]) -> list[Flag]:
    """``not_identified`` with the parameters that the data do not determine."""
    missing = [one for one in parameters if not one.identified]
    if not missing:
        return []
    symbols = _listed([one.symbol for one in missing], len(parameters))
    values = {"names": [one.name for one in missing]}
    return [Flag("not_identified", f"these data do not determine {symbols}", values)]


def specimen_flags(
    tissue: TissueEstimate,
    facts: Sequence[FittedLog],
    trials: Sequence[TrialFit],
    *,
    sigma_N: float,
    optimisers: dict[str, object],
    noise: str | None = "white",
) -> tuple[Flag, ...]:
    """Flags of a specimen; ``noise``: the intervals' model of it, ``None`` where they know more."""
    flags = [*unidentified(tissue.parameters), *_relaxation_flags(tissue, facts, sigma_N)]
    speed = one_speed(facts)
    if speed is not None and not any(log.has_hold for log in facts):
        words = f"one speed, {speed:.3g} mm/s, and no hold: viscosity rests on the ramp's shape alone"
        flags.append(Flag("single_speed", words, {"speed_mm_s": speed}))
    flags += [*_form_flag(tissue, facts), *_optimum_flags(tissue, optimisers)]
    acf = float(np.median([trial.residual_acf1 for trial in trials]))
    if acf > CORRELATED and noise is not None:
        why = "noise with memory, or a lacking model"
        if noise == "white":
            why = "standard errors for white noise are too small"
        words = f"neighbouring residuals are correlated ({acf:.2f}): {why}"
        flags.append(Flag("residual_correlated", words, {"residual_acf1": acf}))
    return tuple(flags)


def _inside(value: float, interval: tuple[float, float] | None) -> bool:
    return interval is not None and interval[0] <= value <= interval[1]


def reaching(
    named: Mapping[str, tuple[str, float]], found: Mapping[str, ParameterUncertainty], logs: int
) -> tuple[dict[str, ParameterUncertainty], tuple[Flag, ...]]:
    """Intervals that hold the mean of logs fitted alone, where neither lies in the interval of the other."""
    out, middles = dict(found), {}
    for name, own in found.items():
        if own.prediction95 is None or _inside(named[name][1], own.prediction95):
            continue
        low, high = np.log(own.prediction95)
        middle = float(np.exp(0.5 * (low + high)))
        if not _inside(middle, own.ci95_total or own.ci95):
            # of the next log by Student's t, sqrt(n + 1) times as wide as of the mean of n
            ratio = float(np.exp(0.5 * (high - low) / np.sqrt(logs + 1.0)))
            out[name], middles[name] = own.holding(middle / ratio, middle * ratio), middle
    if not middles:
        return out, ()
    symbols, middle = [named[name][0] for name in middles], next(iter(middles.values()))
    words = f"logs fitted alone have {_listed(symbols, len(found))} elsewhere: {symbols[0]} at {middle:.3g}"
    values = {"names": list(middles), "alone": list(middles.values())}
    return out, (Flag("logs_apart", words, values),)


def outside(parameters: tuple[Estimate, ...], found: Mapping[str, ParameterUncertainty]) -> tuple[str, ...]:
    """Identified parameters whose value lies outside an interval of theirs."""
    totals = any(one.ci95_total is not None for one in found.values())
    known = [(one.name, one.value, found[one.name]) for one in parameters if one.name in found]
    return tuple(
        name
        for name, value, own in known
        if value is not None
        and not (_inside(value, own.ci95) and (not totals or _inside(value, own.ci95_total)))
    )


def withheld(
    parameters: tuple[Estimate, ...], names: tuple[str, ...], why: str
) -> tuple[tuple[Estimate, ...], tuple[Flag, ...]]:
    """Parameters without the intervals that can't be believed, which are then not identified."""
    if not names:
        return parameters, ()
    symbols = _listed([one.symbol for one in parameters if one.name in names], len(parameters))
    kept = tuple(
        replace(one, identified=False, detail={**one.detail, "withheld": why}) if one.name in names else one
        for one in parameters
    )
    flag = Flag("interval_withheld", f"no interval for {symbols}: {why}", {"names": list(names)})
    return kept, (flag,)


def unsampled(fit: SpecimenFit, error: Exception) -> SpecimenFit:
    """A fit whose posterior could not be sampled: values without intervals, none identified, and why."""
    names = tuple(one.name for one in fit.parameters if one.value is not None)
    why = "no posterior could be sampled"
    parameters, _ = withheld(fit.parameters, names, why)
    flag = Flag("sampler_not_converged", f"{why}: standard errors only", {"reason": str(error)})
    return replace(fit, parameters=parameters, flags=(*fit.flags, flag))


#: Widths of the total over the statistical interval of the viscosity from which the machine dominates.
DOMINATES = 3.0
#: Check of the residual -> where it looks.
_PLACES: Mapping[str, str] = {
    "shared structure": "alike in all logs",
    "within logs": "within logs",
    "early hold": "early in holds",
    "ramp start": "where ramps start",
}


def posterior_flags(posterior: Posterior) -> tuple[Flag, ...]:
    """Flags of a posterior."""
    sampler = posterior.sampler
    flags = _misfit(posterior.misfit)
    if not sampler.converged:
        reason = str(sampler.detail.get("reason", "its rule was not met"))
        words = f"the sampler stopped after {sampler.draws:,} draws, before its rule was met"
        flags.append(Flag("sampler_not_converged", words, {"reason": reason}))
    flags += _machine(posterior)
    return tuple(flags)


def _misfit(alarm: MisfitAlarm | None) -> list[Flag]:
    """The alarm, where it is raised."""
    if alarm is None or not alarm.raised:
        return []
    raised = [check for check in alarm.checks if check.raised]
    where = _PLACES.get(raised[0].name, f"in the check of {raised[0].name}")
    count = f"{len(raised)} of {len(alarm.checks)} checks"
    words = f"the residual contradicts the model {where} ({count}): no interval holds"
    return [Flag("misfit", words, {"checks": [check.name for check in raised]})]


def _machine(posterior: Posterior) -> list[Flag]:
    """Remark where what is not known of the machine outweighs the noise of the recordings."""
    eta = posterior.parameters.get(VISCOSITY)
    if eta is None or eta.ci95_total is None:
        return []
    statistical, total = eta.ci95[1] - eta.ci95[0], eta.ci95_total[1] - eta.ci95_total[0]
    if total < DOMINATES * statistical:
        return []
    rows = [row for row in posterior.budget if row.parameter == VISCOSITY and row.share is not None]
    parts = [row for row in rows if row.source not in {"total", "noise"}]
    worst = max(parts, key=lambda row: row.sd or 0.0).source if parts else "the machine"
    words = f"the total interval of eta is {total / statistical:.2g} times the statistical, by the {worst}"
    return [Flag("calibration_dominates", words, {"ratio": total / statistical, "source": worst})]
