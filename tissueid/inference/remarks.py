"""Remarks beside a posterior: misfit, a sampler that stopped early, priors that decide."""

from __future__ import annotations

from collections.abc import Mapping

from tissueid.flags import Flag
from tissueid.uncertainty import MisfitAlarm, MisfitCheck, Posterior

#: Widths of the total over the statistical interval of the viscosity from which the machine dominates.
DOMINATES = 3.0
#: Check of the residual -> where it looks.
_PLACES: Mapping[str, str] = {
    "shared structure": "alike in all logs",
    "within logs": "within logs",
    "early hold": "early in holds",
    "ramp start": "where ramps start",
}
VISCOSITY = "viscosity_N_s_per_mm"


def posterior_flags(posterior: Posterior) -> tuple[Flag, ...]:
    """Flags of a posterior."""
    sampler = posterior.sampler
    flags = _misfit(posterior.misfit)
    if not sampler.converged:
        reason = str(sampler.detail.get("reason", "its rule was not met"))
        flags.append(
            Flag(
                "sampler_not_converged",
                f"the sampler stopped after {sampler.draws:,} draws, before its rule was met",
                {"reason": reason},
            )
        )
    total = sampler.detail.get("total")
    if total is not None and not total["converged"]:
        flags.append(
            Flag(
                "sampler_not_converged",
                f"no total interval: its draws are worth {total['worth']:.0f} independent ones",
                {"total_worth": total["worth"]},
            )
        )
    flags += _machine(posterior)
    return tuple(flags)


def _where(check: MisfitCheck) -> str:
    """The place of a check in a sentence."""
    return _PLACES.get(check.name, f"in the check of {check.name}")


def _misfit(alarm: MisfitAlarm | None) -> list[Flag]:
    """The alarm, where it is raised."""
    if alarm is None or not alarm.raised:
        return []
    raised = [check for check in alarm.checks if check.raised]
    return [
        Flag(
            "misfit",
            f"the residual contradicts the model {_where(raised[0])} ({len(raised)} of {len(alarm.checks)} "
            "checks): no interval holds",
            {"checks": [check.name for check in raised]},
        )
    ]


def not_linear(error: Exception, alarm: MisfitAlarm) -> tuple[Flag, ...]:
    """Remark on a fit whose posterior lies nowhere near a point it can be linearised about."""
    said = Flag(
        "sampler_not_converged",
        "no interval, standard errors only: nowhere near the optimum is the posterior like a normal one",
        {"reason": str(error)},
    )
    return (said, *_misfit(alarm))


def without_posterior(error: Exception) -> Flag:
    """Remark on a fit whose posterior could not be sampled: its numbers stand, with standard errors."""
    return Flag(
        "sampler_not_converged",
        "no posterior could be sampled: standard errors only",
        {"reason": str(error)},
    )


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
    worst = max(parts, key=lambda row: row.sd).source if parts else "the machine"
    return [
        Flag(
            "calibration_dominates",
            f"the total interval of eta is {total / statistical:.2g} times the statistical, by the {worst}",
            {"ratio": total / statistical, "source": worst},
        )
    ]
