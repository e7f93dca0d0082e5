"""The document of ``tissueid design``: what was asked, found, ranked and remarked, as plain data."""

from __future__ import annotations

from typing import Any

import numpy as np

from tissueid.design.machine import Machine
from tissueid.design.plan import Against, Judged, Plan
from tissueid.design.precision import Asked
from tissueid.design.tissues import Tissues

#: Rest, in longest relaxation times, after which a tissue counts as recovered.
RECOVERED = 5.0
#: Relaxation times below so many samples are flagged by the fit.
SAMPLES_A_TIME = 2.0


def remarks_on(best: Judged, machine: Machine, tissues: Tissues, asked: Asked) -> list[str]:
    """Sentences on the recommended protocol, the gravest first."""
    out = []
    tau, step = tissues.shortest_tau_s, best.setting.step_s
    if tau < SAMPLES_A_TIME * step:
        out.append(
            f"A relaxation time of {tau:.3g} s is below two samples ({2 * step:.3g} s): fit will flag it, "
            "whatever the precision."
        )
    if best.setting.filter_s > 0.0 and not asked.total:
        out.append(
            f"The force filter of {best.setting.filter_s:g} s is taken as known. The statistical interval of "
            "fit takes no account of it: quote the total one, and plan with --interval total."
        )
    if not asked.total and machine.frame_stiffness_N_per_mm is None:
        out.append("The frame is taken as rigid: measure it (tissueid calibrate-frame) and state it.")
    if asked.recovery_s < RECOVERED * tissues.longest_tau_s:
        out.append(
            f"A rest of {asked.recovery_s:g} s is less than {RECOVERED:g} of the longest relaxation times "
            f"({tissues.longest_tau_s:.3g} s): the next log would not start at rest, as the model has it."
        )
    deepest = max(test.depth_mm for test in best.protocol)
    if tissues.known_depth_mm is not None and deepest > tissues.known_depth_mm:
        out.append(
            f"It goes to {deepest:g} mm, and the tissue is known to {tissues.known_depth_mm:.3g} mm: beyond "
            "that its law is a continuation."
        )
    if len({test.speed_mm_min for test in best.protocol}) == 1:
        out.append("All its logs have one speed: that the law holds at others is not checked by it.")
    longest = max(test.hold_s for test in best.protocol)
    slow = f"relaxation slower than its longest hold ({longest:g} s)" if longest > 0.0 else "slow relaxation"
    out.append(
        f"The order of the model is taken as known: {slow} is not seen by it, and would show as a misfit at "
        "the most."
    )
    return out


DESIGN_SCHEMA = "tissueid/design/1"


def _setting(judged: Judged) -> dict[str, Any]:
    setting = judged.setting
    return {
        "words": setting.words,
        "rate_Hz": setting.rate_Hz,
        "noise_N": setting.noise_N,
        "noise_correlation_s": setting.noise_correlation_s,
        "filter_s": setting.filter_s,
    }


def _protocol(one: Judged, asked: Asked, specimens: int) -> dict[str, Any]:
    rows = zip(one.protocol.items(), one.log_seconds, one.peak_N, strict=True)
    found = zip(asked.wants, one.median, one.assured, strict=True)
    return {
        "reached": one.reached,
        "seconds": one.seconds,
        "total_seconds": specimens * one.seconds,
        "logs": one.logs,
        "setting": _setting(one),
        "indentations": [
            {
                "words": test.words,
                "speed_mm_min": test.speed_mm_min,
                "depth_mm": test.depth_mm,
                "hold_s": test.hold_s,
                "repeats": count,
                "seconds": seconds,
                "peak_force_N": peak,
            }
            for (test, count), seconds, peak in rows
        ],
        "precision": [
            {"name": want.name, "wanted": want.share, "median": median, "assured": assured}
            for want, median, assured in found
        ],
        "worst": one.worst,
    }


def _against(given: Against | None, asked: Asked, specimens: int) -> dict[str, Any] | None:
    if given is None:
        return None
    found = given.judged
    return {
        "name": given.name,
        "obstacle": given.obstacle or None,
        "protocol": None if found is None else _protocol(found, asked, specimens),
    }


def _tissue(tissues: Tissues) -> dict[str, Any]:
    numbers = []
    for name, values in tissues.numbers().items():
        low, middle, high = np.quantile(values, (0.025, 0.5, 0.975))
        numbers.append({"name": name, "median": middle, "low": low, "high": high})
    return {
        "name": tissues.name,
        "words": tissues.words,
        "draws": tissues.theta.shape[0],
        "law": tissues.model.name,
        "branches": tissues.model.branches,
        "stiffness_degree": tissues.model.stiffness_degree,
        "depth_mm": tissues.model.depth_mm,
        "numbers": numbers,
    }


def _verdict(plan: Plan, machine: Machine, tissues: Tissues, asked: Asked) -> dict[str, Any]:
    limits = [
        {"name": one.name, "words": one.words, "factor": one.factor, "enough": one.enough}
        for one in plan.limits
    ]
    return {
        "reached": plan.best.reached,
        "limits": limits,
        "remarks": remarks_on(plan.best, machine, tissues, asked),
    }


def design_document(
    plan: Plan,
    machine: Machine,
    tissues: Tissues,
    asked: Asked,
    *,
    given: Against | None = None,
    specimens: int = 1,
) -> dict[str, Any]:
    """The document of ``schemas/design.schema.json``.

    ``given``: a protocol to compare with; ``specimens``: how many will be tested.
    """
    return {
        "schema": DESIGN_SCHEMA,
        "tissue": _tissue(tissues),
        "machine": machine.as_json(),
        "asked": {
            "wants": [{"name": want.name, "share": want.share} for want in asked.wants],
            "interval": "total" if asked.total else "statistical",
            "assurance": asked.assurance,
            "max_depth_mm": asked.max_depth_mm,
            "max_force_N": asked.max_force_N,
            "budget_s": asked.budget_s,
            "recovery_s": asked.recovery_s,
            "setup_s": asked.setup_s,
            "repeats": asked.repeats,
            "max_logs": asked.max_logs,
            "gain_sd": asked.gain_sd,
            "specimens": specimens,
        },
        "verdict": _verdict(plan, machine, tissues, asked),
        "protocols": [_protocol(one, asked, specimens) for one in plan.ranked],
        "against": _against(given, asked, specimens),
        "front": [{"factor": factor, **_protocol(one, asked, specimens)} for factor, one in plan.front],
        "work": {"paths": plan.paths, "protocols": plan.protocols},
    }
