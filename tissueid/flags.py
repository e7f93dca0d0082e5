"""Everything tissueid may say about a recording or a fit, in one table.

A flag is a warning with a stable code, a plain sentence and the numbers behind it.  Codes are listed
here once; ``schemas/flag.schema.json`` repeats the enumeration and a test holds the two together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

__all__ = ["FLAG_CODES", "Flag"]

#: code -> what it means, for the report and the documentation.
FLAG_CODES: Mapping[str, str] = MappingProxyType(
    {
        # the file
        "column_choice": "several columns could be the displacement or the force; one was taken by rule",
        "units_assumed": "the file states no unit for a column; mm, N or s was assumed",
        "undecoded_text": "some header text could not be decoded; numbers are unaffected",
        "rows_skipped": "rows without numbers (comments, results) stand among the data and were left out",
        "cut_row": "the last row is incomplete and was left out",
        # the samples
        "zero_dt": "two samples carry the same time",
        "event_rows": "extra samples stand close beside their neighbours, as written at segment changes",
        "gap": "the log has a gap in time",
        "quantised_force": "the force has few distinct levels for its range",
        "no_decimals": "no number of the recording has decimals: were decimal marks lost?",
        "jump": "the travel leaps between two samples and stays there",
        "not_a_specimen": "a mean curve, a summary or a search for contact: no specimen",
        "cantilever_bending": "the travel holds the bending of the cantilever",
        "unit_overridden": "the file states another unit than the user did; the user's was taken",
        "normalised_axes": "the recording is normalised (strain, stress): nothing here is in mm or N",
        "spike": "single samples stand far off their neighbours",
        "rendered": "the recording is the log of a rendered session: a force law, no measurement",
        "commanded_displacement": "the displacement is free of noise and lag: commanded, not measured?",
        "below_resolution": "displacement or force changes by few of its resolution steps",
        "below_cell_range": "the force is small against the load cell's verified range",
        "clipped_force": "the force stands at its extreme for several samples: clipped load cell",
        "too_few_samples": "too few samples to segment or fit",
        # the segments
        "no_contact": "no contact between tool and tissue was found",
        "no_ramp": "no loading ramp was found",
        "no_hold": "no hold was found: there is nothing to relax",
        "cyclic": "the recording is cyclic",
        "several_steps": "the recording has several ramp-and-hold steps",
        "rupture": "the force collapses while the tool moves on: the tissue broke or the tool slipped",
        "doubtful_rupture": "most of the force is lost within 0.1 s of a stop: relaxation, or a rupture?",
        "slip": "the force falls a little on a ramp and recovers: the tool or the grip slipped",
        "adhesion": "tissue pulls at the tool as it leaves",
        "speed_differs": "the ramp runs at another speed than the file states",
        "load_limit_stop": "the ramp ended at a load limit, not at a depth",
        "preconditioned": "the last cycles change by less than 2 %",
        "not_preconditioned": "the last cycles still change by 2 % or more",
        "corner_slow": "the crosshead took long to stop",
        "decision_overridden": "the user decided this instead of the data",
        "aborted_ramp": "the recording ends, or unloads, before the ramp is over",
        "starts_in_contact": "the recording starts in contact or within its noise: no samples in air",
        "baseline_drift": "the force drifts while the tool is in air",
        "preload": "the force at the start is above its noise: the tissue was preloaded",
        "contact_uncertain": "the contact point is known only to a large part of the depth",
        "corner_overshoot": "displacement overshoots or rings where the ramp stops",
        "sign_assumed": "compression could not be told from tension; the dominant excursion was taken",
        "tension": "the force grows against the travel or the specimen is pulled",
        # the fit
        "not_identified": "the data do not determine this parameter",
        "one_speed_ratio": "no sample is slower than contact began: static force and damping are one number",
        "interval_open": "the interval of a relaxation time runs into the bound of its range",
        "tau_below_resolution": "a relaxation time is shorter than two sampling intervals",
        "amplitude_small": "the relaxing force is below what its noise lets one time",
        "tau_exceeds_window": "a relaxation time is longer than a third of its window",
        "window_dependent": "halving the window moves the relaxation time by more than a fifth",
        "one_tau_inadequate": "one relaxation time does not describe the hold",
        "residual_correlated": "neighbouring residuals are correlated: noise with memory, or a lacking model",
        "residual_large": "the largest residual is more than a twentieth of the force range",
        "bound_active": "a passivity bound is active at the optimum",
        "contact_loss_ambiguous": "after the tool lets go the surface has several force-free positions",
        "optimisers_disagree": "Levenberg-Marquardt and variable projection ended at different optima",
        "not_converged": "Levenberg-Marquardt did not converge",
        "single_speed": "one speed and no hold: only the ramp's shape tells viscosity from static stiffness",
        "unloading_not_settled": "the fit of unloading did not converge",
        "contact_loss_misfit": "the load cell shows a force while the model has the tool in air",
        "form_dependent": "the share of F_s and K, or the relaxation time, rests on the form of the law",
        "unloading_left_out": "samples after the tool first turned back took no part in the fit",
        "frame_corrected": "the deflection of machine and fixture was taken off the displacement",
        "gain_spread": "logs of one specimen differ much in stiffness",
        "repeated_site": "one site was tested more than once",
        "order_effect": "force changes with the order of the tests",
        "modulus_out_of_range": "the modulus formula was used outside the range it was derived for",
        "poroelastic": "relaxation may be fluid flow, not viscosity",
        "sampler_not_converged": "the sampler stopped before its rule was met: intervals are rough",
        "misfit": "the residuals show what model and noise can't make: no interval can be believed",
        "discrepancy": "the model misses more than the measured noise; intervals were widened for it",
        "interval_withheld": "value and intervals do not agree: no interval is given",
        "model_undecided": "the data do not decide between two models",
        "calibration_dominates": "what is not known of the machine outweighs the noise of the recordings",
        "prior_dominated": "a prior decides this more than the data do",
        # the cohort
        "speed_confounded": "speeds were tested on specimens of their own: speed can't be told from specimen",
        "population_not_converged": "chains over the population did not converge: its intervals are rough",
        "specimen_outlier": "a specimen is far from the others",
        "likelihood_smoothed": "population lies among few draws of a specimen: its likelihood was smoothed",
        "draws_floored": "a force or stiffness is zero in draws; it was set to a small share of its median",
        "population_not_passive": "specimens drawn from the population were not passive and were drawn again",
        "covariate_missing": "a covariate is not stated of all specimens; its mean was taken",
        "compliance_unknown": "frame compliance, force filter and time skew were not stated; taken as none",
    }
)


@dataclass(frozen=True, slots=True)
class Flag:
    """One remark.

    Attributes
    ----------
    code : str
        Key of :data:`FLAG_CODES`.
    message : str
        One plain sentence with its numbers.
    values : mapping
        The numbers behind the sentence; they appear beside ``code`` and ``message`` in JSON.
    """

    code: str
    message: str
    values: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.code not in FLAG_CODES:
            msg = f"unknown flag code {self.code!r}"
            raise ValueError(msg)
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))

    def as_json(self) -> dict[str, Any]:
        """``{"code", "message", ...values}``."""
        return {"code": self.code, "message": self.message, **self.values}
