"""What has to be said beside a posterior: misfit, a sampler that stopped early, priors that decide."""

from __future__ import annotations

from tissueid.flags import Flag
from tissueid.uncertainty import MisfitAlarm, Posterior

__all__ = ["not_linear", "posterior_flags", "without_posterior"]

#: Widths of the total over the statistical interval of the viscosity from which the machine dominates.
DOMINATES = 3.0
VISCOSITY = "viscosity_N_s_per_mm"


def posterior_flags(posterior: Posterior) -> tuple[Flag, ...]:
    """Flags of a posterior.

    Parameters
    ----------
    posterior : Posterior
    """
    sampler = posterior.sampler
    flags = _misfit(posterior.misfit)
    if not sampler.converged:
        reason = str(sampler.detail.get("reason", "its rule was not met"))
        flags.append(
            Flag(
                "sampler_not_converged",
                f"the sampler stopped before its rule was met ({reason}): intervals are rough; more --draws, "
                "or --sampler exact, may do",
                {"reason": reason},
            )
        )
    total = sampler.detail.get("total")
    if total is not None and not total["converged"]:
        flags.append(
            Flag(
                "sampler_not_converged",
                f"no total interval is given: its draws are worth {total['worth']:.0f} independent ones; "
                "stating the machine in [calibration] of study.toml narrows what they have to search",
                {"total_worth": total["worth"]},
            )
        )
    flags += _machine(posterior)
    return tuple(flags)


def _misfit(alarm: MisfitAlarm | None) -> list[Flag]:
    """The alarm, where it is raised."""
    if alarm is None or not alarm.raised:
        return []
    raised = [check for check in alarm.checks if check.raised]
    return [
        Flag(
            "misfit",
            "no interval can be believed: " + "; ".join(check.message for check in raised),
            {"checks": [check.name for check in raised]},
        )
    ]


def not_linear(error: Exception, alarm: MisfitAlarm) -> tuple[Flag, ...]:
    """What is said of a fit whose posterior lies nowhere near a point it can be linearised about."""
    said = Flag(
        "sampler_not_converged",
        f"no interval is given ({error}): fewer branches, a smaller contact_sd_mm in [[override]], or logs "
        "of one specimen only may do; standard errors are all there is",
        {"reason": str(error)},
    )
    return (said, *_misfit(alarm))


def without_posterior(error: Exception) -> Flag:
    """What is said of a fit whose posterior could not be sampled: its numbers stand, with standard errors."""
    return Flag(
        "sampler_not_converged",
        f"no posterior could be sampled ({error}): standard errors are all there is; --sampler exact may do",
        {"reason": str(error)},
    )


def _machine(posterior: Posterior) -> list[Flag]:
    """Where what is not known of the machine outweighs the noise of the recordings."""
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
            f"the total interval of eta is {total / statistical:.2g} times the statistical one, most of it "
            f"from the {worst}: state it in [calibration] of study.toml to know more",
            {"ratio": total / statistical, "source": worst},
        )
    ]
