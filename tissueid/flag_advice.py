"""Meaning of each flag for a result, what can be done about it, and which of two does more harm.

One entry for each code of :data:`tissueid.flags.FLAG_CODES`; a test holds the two together.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

__all__ = ["FLAG_ADVICE", "HARM", "MOST_WORDS", "Advice", "flag_level", "harm_rank", "warning_line"]

#: Words of a warning, its way out included.
MOST_WORDS = 25
#: Remedy of a flag that asks for nothing.
NOTHING = "Nothing."


class Advice(NamedTuple):
    """Consequence of a flag, and the way out.

    Attributes
    ----------
    follows : str
        For the result.
    remedy : str
        For the user, in ten words; :data:`NOTHING` where it only informs.
    many : str
        What is said of several recordings or specimens that carry it, behind their number.
    """

    follows: str
    remedy: str
    many: str


_FILE = {
    "column_choice": Advice(
        "If the rule took the wrong column, every number is of the wrong quantity.",
        "State others with --columns, if that is wrong.",
        "have several columns that fit",
    ),
    "units_assumed": Advice(
        "If the unit is another, forces or depths are wrong by its factor, and so is every parameter.",
        "State it: --units force=kN, or in study.toml.",
        "state no unit for a column",
    ),
    "undecoded_text": Advice(
        "Only names and remarks of the header may look odd; numbers are unaffected.",
        "Export as UTF-8, if names look odd.",
        "have a header of uncertain encoding",
    ),
    "rows_skipped": Advice(
        "Rows of text took no part; samples did.",
        "Look at those lines, if they were samples.",
        "hold rows that were left out",
    ),
    "cut_row": Advice(
        "One sample is missing; the export was probably cut short, and more may be.",
        "Export again, if the recording should be longer.",
        "end in an incomplete row",
    ),
    "unit_overridden": Advice(
        "The result is as right as the unit that was stated by hand.",
        "Check the unit against the machine.",
        "state another unit than was taken",
    ),
    "normalised_axes": Advice(
        "Parameters are in units of strain and stress and can't be rendered.",
        "Export displacement and force, to feel a tissue.",
        "are normalised",
    ),
    "not_a_specimen": Advice(
        "It is shown, and takes no part in a fit.",
        "List it under [[trial]] of study.toml, if it is one.",
        "are no specimens",
    ),
    "cantilever_bending": Advice(
        "The tip went less deep than the travel says, so that the tissue looks softer.",
        "State frame_stiffness_N_per_mm in [calibration] of study.toml.",
        "hold the bending of a cantilever",
    ),
    "rendered": Advice(
        "A fit returns the law that was rendered. It says nothing new of the tissue.",
        "Use it to check a session, not to identify.",
        "are rendered, not measured",
    ),
}
_SAMPLES = {
    "zero_dt": Advice(
        "The samples share one instant; speeds there mean nothing.",
        "Export time with more digits.",
        "repeat times",
    ),
    "event_rows": Advice(
        "They are counted as samples of next to no duration.",
        "Nothing.",
        "have extra samples at changes of a segment",
    ),
    "gap": Advice(
        "What the force did in the gap is not known; the model runs through it on an interpolated path.",
        "Log at a constant rate, or leave the recording out.",
        "have gaps in time",
    ),
    "quantised_force": Advice(
        "Small changes of the force are lost; relaxation may look like steps.",
        "Take a smaller load cell, or export more digits.",
        "have a force of few levels",
    ),
    "no_decimals": Advice(
        "If a decimal mark was lost, numbers are too large by a power of ten.",
        "Export again with more digits, or state --decimal.",
        "may have lost decimal marks",
    ),
    "jump": Advice(
        "What happened in between is missing; after it another recording may go on.",
        "Cut it by start_s or end_s of study.toml.",
        "leap between two samples",
    ),
    "spike": Advice(
        "Single samples may pull the fit and look like misfit.",
        "Look for a bad cable.",
        "have single samples far off",
    ),
    "commanded_displacement": Advice(
        "No crosshead turns so sharply: where the tool really was is not recorded; lag and give of "
        "the machine become tissue.",
        "Export the measured displacement.",
        "may hold the commanded displacement",
    ),
    "below_resolution": Advice(
        "The channel says little more than its steps.",
        "Take a finer sensor, or go deeper.",
        "go through few resolution steps",
    ),
    "below_cell_range": Advice(
        "The load cell's class holds only in its verified range; below it the force may be off by more.",
        "Take a smaller cell, or state verified_from_N.",
        "stay below the load cell's verified range",
    ),
    "clipped_force": Advice(
        "The true peak was higher; stiffness is too low.",
        "Take a larger load cell, or less depth.",
        "have a clipped force",
    ),
    "too_few_samples": Advice(
        "There is nothing to segment or fit.",
        "Sample faster, or let the test run on.",
        "have too few samples",
    ),
}
_SEGMENTS = {
    "no_contact": Advice(
        "The recording is not fitted.",
        "Start nearer, push deeper, or state --contact.",
        "show no contact",
    ),
    "no_ramp": Advice(
        "There is no loading to fit.",
        "Look at it with `tissueid inspect --html`.",
        "show no ramp",
    ),
    "no_hold": Advice(
        "Relaxation times come from the shape of ramps alone, and may not be identified.",
        "Hold at the largest depth, longer than tissue relaxes.",
        "show no hold",
    ),
    "cyclic": Advice(
        "Loading is fitted; turns and loops are measured.",
        "Add --unloading to fit retracts.",
        "are cyclic",
    ),
    "several_steps": Advice(
        "Every step is fitted with one tissue.",
        "Nothing.",
        "have several steps",
    ),
    "rupture": Advice(
        "The fit ends there: what follows is another specimen; `tissueid rupture` studies it.",
        "Correct it by [[override]] of study.toml, if untrue.",
        "show a rupture",
    ),
    "doubtful_rupture": Advice(
        "The hold is kept, as if the tissue were whole.",
        "Look at the curve: --exclude leaves it out.",
        "lose most of their force at a stop",
    ),
    "slip": Advice(
        "The fit follows the force through it.",
        "Look at the grip: --exclude leaves it out.",
        "slip on a ramp",
    ),
    "adhesion": Advice(
        "Loading and holds are fitted; the model has no pull, so unloading does not follow.",
        "Wet or powder the tip, or leave the retract out.",
        "pull at the tool as it leaves",
    ),
    "speed_differs": Advice(
        "The measured speed counts; the machine did not do what its header says.",
        "Check the header and the time column.",
        "run at another speed than stated",
    ),
    "load_limit_stop": Advice(
        "The depth is not the one asked for; it is the measured one that counts.",
        "Raise the limit, if the depth is wanted.",
        "stop at a load limit",
    ),
    "preconditioned": Advice(
        "Cycles before the test settled; it is what one hopes for.",
        "Nothing.",
        "settled in their last cycles",
    ),
    "not_preconditioned": Advice(
        "The tissue was still changing; repeated tests will not agree.",
        "Precondition for more cycles.",
        "still change from cycle to cycle",
    ),
    "corner_slow": Advice(
        "Relaxation that is faster than the stop can't be seen.",
        "Use a stiffer controller, or a slower ramp.",
        "stop slowly",
    ),
    "corner_overshoot": Advice(
        "The fit follows the measured path, overshoot included.",
        "Tune the controller, if it is large.",
        "overshoot where the ramp stops",
    ),
    "decision_overridden": Advice(
        "The result follows your decision.",
        "Change it in study.toml, where it is wrong.",
        "follow a decision of the study",
    ),
    "aborted_ramp": Advice(
        "The recording shows less depth than was asked for.",
        "Repeat the test.",
        "end before their ramp does",
    ),
    "starts_in_contact": Advice(
        "Zero force and zero depth were not seen; the linear static term may be off.",
        "Start in air, or state --contact.",
        "start in contact",
    ),
    "baseline_drift": Advice(
        "The zero of the force is uncertain by the drift.",
        "Let the load cell warm up, then zero it.",
        "drift in air",
    ),
    "preload": Advice(
        "Depth counts from the preloaded surface, not from the free one; tissue that had relaxed "
        "under it, slower than the ramp, was met further back.",
        "Start in air, or state --contact.",
        "start preloaded",
    ),
    "contact_uncertain": Advice(
        "Depth, and what grows with it, is uncertain by that much; intervals know of it.",
        "Start in air; approach at the ramp's speed.",
        "have an uncertain contact",
    ),
    "sign_assumed": Advice(
        "If the guess is wrong the recording is read upside down.",
        "State --compression positive or negative.",
        "leave the sign of compression open",
    ),
    "tension": Advice(
        "A contact model does not describe pulling.",
        "Check the mounting, or state --compression.",
        "look like tension",
    ),
}
_FIT = {
    "not_identified": Advice(
        "No value is given: other values fit these data as well.",
        "Test a second speed, hold longer, or sample faster.",
        "leave parameters undetermined",
    ),
    "one_speed_ratio": Advice(
        "Static coefficient and restitution are withheld; their product k (1 + chi) is known.",
        "Record a hold or the unloading too.",
        "leave static force and damping one number",
    ),
    "interval_open": Advice(
        "The data bound the relaxation time on one side only.",
        "Too short: sample faster. Too long: hold longer.",
        "have a relaxation time with an open interval",
    ),
    "tau_below_resolution": Advice(
        "The branch is a jump of the force at this rate; its time is not measured.",
        "Sample ten times faster, or quote the viscosity alone.",
        "relax faster than was sampled",
    ),
    "amplitude_small": Advice(
        "The relaxing force drowns in noise.",
        "Go faster or deeper, or repeat to average.",
        "relax by less than noise lets one time",
    ),
    "tau_exceeds_window": Advice(
        "The hold ended before this relaxation did; its time is an extrapolation.",
        "Hold three times as long.",
        "relax longer than was held",
    ),
    "window_dependent": Advice(
        "The relaxation is not one exponential; its time depends on where one looks.",
        "Quote the window beside the time, or add a branch.",
        "have a relaxation time that depends on its window",
    ),
    "one_tau_inadequate": Advice(
        "One exponential leaves structure in the hold.",
        "Quote two or three, or let --branches auto choose.",
        "relax in more than one time",
    ),
    "residual_correlated": Advice(
        "White-noise standard errors are too small; sampled intervals know the memory of the noise.",
        "Trust sampled intervals, not standard errors.",
        "leave correlated residuals",
    ),
    "residual_large": Advice(
        "Somewhere the model is off by more than 5 %.",
        "Look where, in the residuals of the report.",
        "leave a residual above 5 % of the force range",
    ),
    "bound_active": Advice(
        "The tissue that fits best stands at the edge of what is passive; its error is not symmetric.",
        "Check the contact point; trust sampled intervals.",
        "stand at the passivity bound",
    ),
    "contact_loss_ambiguous": Advice(
        "Unloading is passive, but not unique, once the tool has left.",
        "Do not render fast retracts.",
        "have several free surfaces after contact loss",
    ),
    "optimisers_disagree": Advice(
        "At least one did not find the best fit; the lower sum of squares was kept. Quote nothing yet.",
        "Simplify: fewer branches, --stiffness-degree 0.",
        "have two optima",
    ),
    "not_converged": Advice(
        "Levenberg-Marquardt gave up; the result of the search stands unconfirmed.",
        "Simplify: fewer branches, --stiffness-degree 0.",
        "did not converge",
    ),
    "single_speed": Advice(
        "Viscosity and static stiffness share one curve; either may hold the other's share.",
        "Test at a second speed, or hold.",
        "have one speed and no hold",
    ),
    "unloading_not_settled": Advice(
        "Numbers of a fit with unloading are rough.",
        "Fit without --unloading.",
        "have an unloading that did not settle",
    ),
    "contact_loss_misfit": Advice(
        "Tissue sticks, or recovers otherwise than the model says.",
        "Trust loading only.",
        "show a force in air",
    ),
    "form_dependent": Advice(
        "Of one speed and one depth, the split between F_s and K at smaller depths is the polynomials', "
        "not the data's; a relaxation time that follows the hold is one of that window.",
        "Test a second speed or depth.",
        "have numbers that rest on the form of the law",
    ),
    "unloading_left_out": Advice(
        "Only loading and holds are fitted.",
        "Add --unloading.",
        "have samples that were not fitted",
    ),
    "frame_corrected": Advice(
        "Depths are the tissue's alone, as far as the frame is known.",
        "Measure it again with `tissueid calibrate-frame`, if in doubt.",
        "were corrected for the frame",
    ),
    "gain_spread": Advice(
        "Sites or moments differ; the shared tissue is an average.",
        "Fit them as specimens of their own.",
        "have logs of different stiffness",
    ),
    "repeated_site": Advice(
        "Later tests met tissue that had been tested.",
        "Leave rest, or change the site.",
        "were tested at one site again",
    ),
    "order_effect": Advice(
        "Something changes while you test: drying, damage, recovery.",
        "Precondition, and randomise the order.",
        "change with the order of the tests",
    ),
    "modulus_out_of_range": Advice(
        "The modulus is an extrapolation of its formula; the stiffness stands.",
        "Quote the stiffness, or state --thickness.",
        "have a modulus outside its formula's range",
    ),
    "poroelastic": Advice(
        "A relaxation time lies where fluid drains from under a contact of this size (a^2/D, D of "
        "10⁻¹¹ to 10⁻⁸ m²/s); with another tip fluid flow slows with the square of its radius, "
        "viscosity does not.",
        "Repeat with a tip of another radius.",
        "may relax by fluid flow",
    ),
    "sampler_not_converged": Advice(
        "Intervals are rough, or there are none; stating the machine in [calibration] narrows what a "
        "total interval has to search.",
        "Take fewer --branches, or state the machine.",
        "have rough intervals",
    ),
    "discrepancy": Advice(
        "The model is simpler than the tissue; its parameters describe this program, not any other. "
        "Intervals count several samples as one.",
        "Look at the largest residual; add a branch.",
        "are missed by more than the noise",
    ),
    "interval_withheld": Advice(
        "The number stands without an interval: it may be far from what other data would give.",
        "Add logs, state the machine, or take --branches 1.",
        "have a value without interval",
    ),
    "misfit": Advice(
        "The model is wrong in a way the residuals show; intervals would be of a wrong model.",
        "Look at that check; add a branch, state the machine.",
        "contradict the model",
    ),
    "model_undecided": Advice(
        "Another model would predict as well; parameters that differ between them are not settled.",
        "Add a second speed; --branches and --stiffness-degree fit one order.",
        "do not decide between models",
    ),
    "calibration_dominates": Advice(
        "More tests will not narrow the total interval; knowing the machine will.",
        "State it in [calibration]; `tissueid calibrate-frame` measures a frame.",
        "are limited by the machine",
    ),
    "prior_dominated": Advice(
        "The number is mostly what was believed before.",
        "State the prior when quoting, or test more.",
        "are decided by a prior",
    ),
    "compliance_unknown": Advice(
        "A short relaxation time may be the machine's.",
        "State them in [calibration].",
        "leave the machine unstated",
    ),
}
_COHORT = {
    "speed_confounded": Advice(
        "A difference between speeds may be one between specimens; no effect of speed can be claimed.",
        "Test every specimen at every speed.",
        "have speeds of their own",
    ),
    "population_not_converged": Advice(
        "Intervals of the population are rough.",
        "Run again, or add specimens.",
        "have rough intervals of the population",
    ),
    "specimen_outlier": Advice(
        "It counts less with heavy tails, and in full with normal ones.",
        "Look at its recordings, and keep it.",
        "are far from the others",
    ),
    "likelihood_smoothed": Advice(
        "The specimen's posterior hardly reaches the population; its share is approximate.",
        "Fit them with more --draws.",
        "have a smoothed likelihood",
    ),
    "draws_floored": Advice(
        "Such a draw lies far from the others, in the logarithm.",
        "Look at bounds and contact point.",
        "have draws without force",
    ),
    "population_not_passive": Advice(
        "New specimens are drawn from the passive part of the population.",
        "Add specimens, where many are.",
        "were drawn again",
    ),
    "covariate_missing": Advice(
        "Those specimens say nothing about the effect of the covariate.",
        "State it for all.",
        "state no covariate",
    ),
}
FLAG_ADVICE: Mapping[str, Advice] = MappingProxyType({**_FILE, **_SAMPLES, **_SEGMENTS, **_FIT, **_COHORT})

#: Every code by its harm to a number, the worst first, in the three levels that a reader meets.
HARM: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "serious": (
            "no_decimals", "clipped_force", "too_few_samples", "no_contact", "no_ramp", "misfit",
            "not_converged", "optimisers_disagree", "interval_withheld", "quantised_force", "single_speed",
            "population_not_converged", "speed_confounded",
        ),
        "caution": (
            "unit_overridden", "sign_assumed", "tension", "rendered", "rupture", "doubtful_rupture",
            "speed_differs", "adhesion", "slip", "not_identified", "discrepancy", "sampler_not_converged",
            "unloading_not_settled", "aborted_ramp", "jump", "gap", "spike", "zero_dt",
            "commanded_displacement", "below_resolution", "below_cell_range", "cantilever_bending",
            "contact_uncertain", "baseline_drift", "bound_active", "tau_exceeds_window",
            "tau_below_resolution", "one_speed_ratio", "interval_open", "amplitude_small", "form_dependent",
            "window_dependent", "one_tau_inadequate", "residual_large", "residual_correlated",
            "contact_loss_misfit", "contact_loss_ambiguous", "gain_spread", "order_effect", "repeated_site",
            "not_preconditioned", "corner_slow", "corner_overshoot", "prior_dominated",
            "modulus_out_of_range", "poroelastic", "unloading_left_out", "specimen_outlier",
            "covariate_missing", "population_not_passive",
        ),
        "note": (
            "not_a_specimen", "units_assumed", "normalised_axes", "compliance_unknown",
            "calibration_dominates", "model_undecided", "preload", "starts_in_contact", "no_hold",
            "cut_row", "rows_skipped", "decision_overridden", "load_limit_stop", "column_choice",
            "undecoded_text", "several_steps", "cyclic", "event_rows", "frame_corrected", "preconditioned",
            "likelihood_smoothed", "draws_floored",
        ),
    }
)  # fmt: skip
_RANK = {code: rank for rank, code in enumerate(code for codes in HARM.values() for code in codes)}
_LEVEL = {code: level for level, codes in HARM.items() for code in codes}


def flag_level(code: str) -> str:
    """Gravity of a flag: ``serious``, ``caution`` or ``note``; one of a later version is a caution."""
    return _LEVEL.get(code, "caution")


def harm_rank(code: str) -> int:
    """Place of a flag among all, 0 for the worst; one of a later version stands behind those known."""
    return _RANK.get(code, len(_RANK))


def warning_line(code: str, message: str) -> str:
    """A flag in at most :data:`MOST_WORDS` words: what was seen, with its number, and the way out.

    Parameters
    ----------
    code : str
    message : str
        The flag's own; words that a user put into it are cut where they are too many.
    """
    advice = FLAG_ADVICE.get(code)
    remedy = "" if advice is None or advice.remedy == NOTHING else advice.remedy
    room = MOST_WORDS - len(remedy.split())
    words = message.rstrip(".?").split()
    seen = " ".join(words) if len(words) <= room else f"{' '.join(words[:room])} ..."
    return f"{seen}. {remedy}".rstrip() if remedy else seen
