"""The flags of a specimen for a reader: a short title and its gravity for each code, gathered over trials.

The sentence with the numbers is the flag's own; the title says in a few words what it is about, and neither
repeats the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from tissueid.digits import typeset
from tissueid.flag_advice import flag_level, harm_rank

__all__ = ["LEVELS", "REMARK_TITLES", "Remark", "remark_title", "remarks", "trial_label"]

#: From harmless to grave.
LEVELS = ("ok", "note", "caution", "serious")
#: Code -> what it is about, without a verb.
REMARK_TITLES: Mapping[str, str] = MappingProxyType(
    {
        "column_choice": "Choice of columns",
        "units_assumed": "Units",
        "rendered": "No measurement",
        "undecoded_text": "Encoding",
        "rows_skipped": "Rows left out",
        "cut_row": "End of the file",
        "zero_dt": "Time stamps",
        "event_rows": "Event rows",
        "gap": "Gap",
        "quantised_force": "Force resolution",
        "no_decimals": "Decimals",
        "unit_overridden": "Unit by hand",
        "normalised_axes": "Normalised axes",
        "jump": "Leap",
        "not_a_specimen": "No specimen",
        "cantilever_bending": "Cantilever",
        "spike": "Outliers",
        "commanded_displacement": "Commanded displacement",
        "below_resolution": "Resolution",
        "below_cell_range": "Load-cell range",
        "clipped_force": "Clipped force",
        "too_few_samples": "Samples",
        "no_contact": "No contact",
        "no_ramp": "No ramp",
        "no_hold": "No hold",
        "cyclic": "Cyclic test",
        "several_steps": "Several steps",
        "rupture": "Rupture",
        "doubtful_rupture": "Rupture?",
        "slip": "Slip",
        "adhesion": "Adhesion",
        "speed_differs": "Speed",
        "load_limit_stop": "Load limit",
        "preconditioned": "Preconditioning",
        "not_preconditioned": "Preconditioning",
        "corner_slow": "Slow stop",
        "decision_overridden": "Decided by hand",
        "aborted_ramp": "Aborted test",
        "starts_in_contact": "Start in contact",
        "baseline_drift": "Load-cell zero",
        "preload": "Preload",
        "contact_uncertain": "Uncertain contact",
        "corner_overshoot": "Overshoot",
        "sign_assumed": "Sign",
        "tension": "Tension",
        "not_identified": "Not identified",
        "one_speed_ratio": "One speed ratio",
        "interval_open": "Open interval",
        "tau_below_resolution": "Sampling",
        "amplitude_small": "Small relaxation",
        "tau_exceeds_window": "Short hold",
        "window_dependent": "Window",
        "one_tau_inadequate": "One exponential",
        "residual_correlated": "Correlated residual",
        "residual_large": "Large residual",
        "bound_active": "Passivity",
        "contact_loss_ambiguous": "Contact loss",
        "optimisers_disagree": "Two optima",
        "not_converged": "Convergence",
        "single_speed": "One speed",
        "form_dependent": "Form of the law",
        "unloading_not_settled": "Unloading",
        "contact_loss_misfit": "Contact loss",
        "unloading_left_out": "Unloading",
        "frame_corrected": "Frame",
        "gain_spread": "Spread of the trials",
        "repeated_site": "Repeated site",
        "order_effect": "Order of the tests",
        "modulus_out_of_range": "Range of the modulus",
        "poroelastic": "Fluid flow",
        "sampler_not_converged": "Sampler",
        "misfit": "Misfit",
        "discrepancy": "Misfit beside the noise",
        "interval_withheld": "Interval withheld",
        "model_undecided": "Choice of the model",
        "calibration_dominates": "Calibration",
        "prior_dominated": "Prior",
        "speed_confounded": "Speed and specimen",
        "population_not_converged": "Convergence",
        "specimen_outlier": "Outliers",
        "likelihood_smoothed": "Smoothed likelihood",
        "draws_floored": "Zero force",
        "population_not_passive": "Passivity",
        "covariate_missing": "Missing covariate",
        "compliance_unknown": "Machine",
    }
)


@dataclass(frozen=True, slots=True)
class Remark:
    """One flag for a reader, gathered over a specimen's trials.

    Attributes
    ----------
    code : str
    level : str
        ``note``, ``caution`` or ``serious``.
    title : str
        What it is about.
    messages : tuple of str
        Its sentences, with numbers; none twice.
    where : tuple of str
        Trials that carry it; empty for the specimen as a whole.
    """

    code: str
    level: str
    title: str
    messages: tuple[str, ...]
    where: tuple[str, ...]

    @property
    def message(self) -> str:
        """All sentences in one, each closed once, powers of ten raised."""
        return typeset("; ".join(part.rstrip(".") for part in self.messages))


def remark_title(code: str) -> str:
    """Title of a flag; a code of a later version is spelt out."""
    return REMARK_TITLES.get(code) or code.replace("_", " ").capitalize()


def trial_label(trial: Mapping[str, Any]) -> str:
    """Short name of a trial: its file, and its sheet where there is one."""
    name = str(trial["path"]).replace("\\", "/").rsplit("/", 1)[-1]
    return name if trial["sheet"] is None else f"{name} [{trial['sheet']}]"


def remarks(specimen: Mapping[str, Any], *, holds: bool = True) -> tuple[Remark, ...]:
    """Every flag of a specimen, its trials and its holds, once a code, the one of most harm first.

    Parameters
    ----------
    specimen : mapping
        One of ``specimens`` of identification.json.
    holds : bool
        With what is said of single exponentials in the holds.
    """
    messages: dict[str, list[str]] = {}
    where: dict[str, list[str]] = {}
    for flag in specimen["flags"]:
        said = messages.setdefault(flag["code"], [])
        where.setdefault(flag["code"], [])
        # several parameters may carry one code: each sentence is kept, and none twice
        if flag["message"] not in said:
            said.append(flag["message"])
    for part in (*specimen["trials"], *(specimen["relaxation"] if holds else ())):
        for flag in part["flags"]:
            messages.setdefault(flag["code"], [flag["message"]])
            places = where.setdefault(flag["code"], [])
            if trial_label(part) not in places:
                places.append(trial_label(part))
    found = [
        Remark(code, flag_level(code), remark_title(code), tuple(said), tuple(where[code]))
        for code, said in messages.items()
    ]
    return tuple(sorted(found, key=lambda remark: harm_rank(remark.code)))
