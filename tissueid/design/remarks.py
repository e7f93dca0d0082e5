"""Remarks of a plan, in sentences."""

from __future__ import annotations

from tissueid.design.machine import Machine
from tissueid.design.plan import Judged
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
