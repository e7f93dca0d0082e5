"""What each flag means for a result, and what can be done about it, in plain words.

One entry for each code of :data:`tissueid.flags.FLAG_CODES`; a test holds the two together.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

__all__ = ["FLAG_ADVICE", "Advice"]


class Advice(NamedTuple):
    """What follows from a flag, and the way out.

    Attributes
    ----------
    follows : str
        For the result.
    remedy : str
        For the user; "Nothing" where it only informs.
    """

    follows: str
    remedy: str


_FILE = {
    "column_choice": Advice(
        "If the rule took the wrong column, every number is of the wrong quantity.",
        "Look at the columns that `tissueid inspect` names; say others with --columns.",
    ),
    "units_assumed": Advice(
        "If the unit is another, forces or depths are wrong by its factor, and so is every parameter.",
        "State it: --units force=kN, or in study.toml.",
    ),
    "undecoded_text": Advice("Only names and remarks of the header may look odd.", "Nothing."),
    "rows_skipped": Advice(
        "Rows of text took no part; samples did.", "Look at the lines named, if they were meant as samples."
    ),
    "cut_row": Advice(
        "One sample is missing; the export was probably cut short, and more may be.",
        "Export again, if the recording should be longer.",
    ),
    "unit_overridden": Advice(
        "The result is as right as the unit that was stated by hand.", "Check the unit against the machine."
    ),
    "normalised_axes": Advice(
        "Parameters are in units of strain and stress and can't be rendered.",
        "Export displacement and force, where a tissue is to be felt.",
    ),
    "rendered": Advice(
        "A fit returns the law that was rendered. It says nothing new of the tissue.",
        "Use it to check a session, not to identify.",
    ),
}
_SAMPLES = {
    "zero_dt": Advice(
        "The samples share one instant; speeds there mean nothing.", "Export time with more digits."
    ),
    "event_rows": Advice("They are counted as samples of next to no duration.", "Nothing."),
    "gap": Advice(
        "What the force did in the gap is not known; the model runs through it on an interpolated path.",
        "Log at a constant rate; leave the recording out if the gap hides a peak.",
    ),
    "quantised_force": Advice(
        "Small changes of the force are lost; relaxation may look like steps.",
        "Take a smaller load cell, or export more digits.",
    ),
    "no_decimals": Advice(
        "If a decimal mark was lost, numbers are too large by a power of ten.",
        "Export again with more digits, or state --decimal.",
    ),
    "spike": Advice(
        "Single samples may pull the fit and look like misfit.", "Look for a bad cable or contact; cut them."
    ),
    "commanded_displacement": Advice(
        "Where the tool really was is not recorded; lag and give of the machine become tissue.",
        "Export the measured displacement.",
    ),
    "below_resolution": Advice(
        "The channel says little more than its steps.", "Take a finer sensor, export more digits, go deeper."
    ),
    "below_cell_range": Advice(
        "The load cell's class holds only in its verified range; below it the force may be off by more.",
        "Take a smaller cell, or state verified_from_N in [calibration] of study.toml.",
    ),
    "clipped_force": Advice(
        "The true peak was higher; stiffness is too low.", "Take a larger load cell, or less depth."
    ),
    "too_few_samples": Advice(
        "There is nothing to segment or fit.", "Sample faster, or let the test run to its end."
    ),
}
_SEGMENTS = {
    "no_contact": Advice("The recording is not fitted.", "Start nearer, push deeper, or state --contact."),
    "no_ramp": Advice("There is no loading to fit.", "Look at it with `tissueid inspect --html`."),
    "no_hold": Advice(
        "Relaxation times come from the shape of ramps alone, and may not be identified.",
        "Hold at the largest depth for several of the slowest relaxation times.",
    ),
    "cyclic": Advice("Loading is fitted; turns and loops are measured.", "Add --unloading to fit retracts."),
    "several_steps": Advice("Every step is fitted with one tissue.", "Nothing."),
    "rupture": Advice(
        "The fit ends there: what follows is another specimen.",
        "`tissueid rupture` studies it; [[override]] of study.toml corrects it.",
    ),
    "doubtful_rupture": Advice(
        "The hold is kept, as if the tissue were whole.", "Look at the curve; --exclude leaves it out."
    ),
    "slip": Advice(
        "The fit follows the force through it.", "Look at the grip; --exclude leaves the recording out."
    ),
    "load_limit_stop": Advice(
        "The depth is not the one asked for; it is the measured one that counts.",
        "Raise the limit if wanted.",
    ),
    "preconditioned": Advice("Cycles before the test settled; it is what one hopes for.", "Nothing."),
    "not_preconditioned": Advice(
        "The tissue was still changing; repeated tests will not agree.", "Precondition for more cycles."
    ),
    "corner_slow": Advice(
        "Relaxation that is faster than the stop can't be seen.",
        "Use a stiffer controller, or a slower ramp.",
    ),
    "corner_overshoot": Advice(
        "The fit follows the measured path, overshoot included.", "Tune the controller if it is large."
    ),
    "decision_overridden": Advice("The result follows your decision.", "Give its reason in study.toml."),
    "aborted_ramp": Advice("The recording shows less depth than was asked for.", "Repeat the test."),
    "starts_in_contact": Advice(
        "Zero force and zero depth were not seen; the linear static term may be off.",
        "Start in air, or state --contact.",
    ),
    "baseline_drift": Advice(
        "The zero of the force is uncertain by the drift.", "Let the load cell warm up, then zero it."
    ),
    "preload": Advice(
        "Depth counts from the preloaded surface, not from the free one.",
        "Start in air, where the free surface is what matters.",
    ),
    "contact_uncertain": Advice(
        "Depth, and what grows with it, is uncertain by that much; intervals know of it.",
        "Start in air and approach at the speed of the ramp.",
    ),
    "sign_assumed": Advice(
        "If the guess is wrong the recording is read upside down.",
        "State --compression positive or negative.",
    ),
    "tension": Advice(
        "A contact model does not describe pulling.", "Check the mounting, or state --compression."
    ),
}
_FIT = {
    "not_identified": Advice(
        "No value is given: other values fit these data as well.",
        "Test at a second speed, hold longer, sample faster; `tissueid inspect` and the report say which.",
    ),
    "interval_open": Advice(
        "The data bound the relaxation time on one side only.",
        "Too short: sample faster. Too long: hold longer.",
    ),
    "tau_below_resolution": Advice(
        "The branch is a jump of the force at this rate; its time is not measured.",
        "Sample at ten times the rate, or quote the viscosity alone.",
    ),
    "amplitude_small": Advice(
        "The relaxing force drowns in noise.", "Go faster or deeper, or repeat to average."
    ),
    "tau_exceeds_window": Advice(
        "The hold ended before this relaxation did; its time is an extrapolation.",
        "Hold three times as long.",
    ),
    "window_dependent": Advice(
        "The relaxation is not one exponential; its time depends on where one looks.",
        "Quote the window beside the time, or use the model with more branches.",
    ),
    "one_tau_inadequate": Advice(
        "One exponential leaves structure in the hold.", "Quote two or three, or let --branches auto choose."
    ),
    "residual_correlated": Advice(
        "White-noise standard errors are too small; sampled intervals know the memory of the noise.",
        "Trust sampled intervals, not standard errors.",
    ),
    "residual_large": Advice("Somewhere the model is off by more than 5 %.", "Look where, in the residuals."),
    "bound_active": Advice(
        "The tissue that fits best stands at the edge of what is passive; its error is not symmetric.",
        "Check the contact point; trust the intervals of a sampler.",
    ),
    "contact_loss_ambiguous": Advice(
        "Unloading is passive, but not unique, once the tool has left.", "Do not render fast retracts."
    ),
    "optimisers_disagree": Advice(
        "At least one did not find the best fit; the lower sum of squares was kept. Quote nothing yet.",
        "Simplify: fewer branches, --stiffness-degree 0.",
    ),
    "not_converged": Advice(
        "Levenberg-Marquardt gave up; the result of the search stands unconfirmed.", "Simplify the model."
    ),
    "single_speed": Advice(
        "Viscosity and static stiffness share one curve; either may hold the other's share.",
        "Test at a second speed, or hold.",
    ),
    "unloading_not_settled": Advice("Numbers of a fit with unloading are rough.", "Fit without --unloading."),
    "contact_loss_misfit": Advice(
        "Tissue sticks, or recovers faster than the model says.", "Trust loading only."
    ),
    "form_dependent": Advice(
        "At smaller depths the split between F_s and K is the polynomials', not the data's.",
        "Test at a second speed, or hold at a second depth.",
    ),
    "unloading_left_out": Advice("Only loading and holds are fitted.", "Add --unloading."),
    "frame_corrected": Advice("Depths are the tissue's alone, as far as the frame is known.", "Nothing."),
    "gain_spread": Advice(
        "Sites or moments differ; the shared tissue is an average.", "Fit them as specimens of their own."
    ),
    "repeated_site": Advice(
        "Later tests met tissue that had been tested.", "Leave rest, or change the site."
    ),
    "order_effect": Advice(
        "Something changes while you test: drying, damage, recovery.", "Randomise the order."
    ),
    "modulus_out_of_range": Advice(
        "The modulus is an extrapolation of its formula; the stiffness stands.",
        "Quote the stiffness, or use the formula of a layer (--thickness).",
    ),
    "poroelastic": Advice(
        "A relaxation time lies where fluid drains from under a contact of this size.",
        "Repeat with a tip of another radius: fluid flow slows with its square, viscosity does not.",
    ),
    "sampler_not_converged": Advice(
        "Intervals are rough, or there are none.", "Try --sampler exact, more --draws, or fewer branches."
    ),
    "discrepancy": Advice(
        "The model is simpler than the tissue; its parameters describe this program, not any other.",
        "Look where the residual is largest; add a branch, or hold longer.",
    ),
    "interval_withheld": Advice(
        "The number stands without an interval: it may be far from what other data would give.",
        "Add logs, state the machine, or fit one branch.",
    ),
    "misfit": Advice(
        "The model is wrong in a way the residuals show; intervals would be of a wrong model.",
        "Look at the named check; add a branch, shorten the window, or state filter and frame.",
    ),
    "model_undecided": Advice(
        "Another model would predict as well; parameters that differ between them are not settled.",
        "Add --compare, or a second speed.",
    ),
    "calibration_dominates": Advice(
        "More tests will not narrow the total interval; knowing the machine will.",
        "State what is known in [calibration]; measure the frame with `tissueid calibrate-frame`.",
    ),
    "prior_dominated": Advice(
        "The number is mostly what was believed before.", "State the prior when quoting, or test more."
    ),
    "compliance_unknown": Advice(
        "A short relaxation time may be the machine's.",
        "State frame, force filter and skew in [calibration]; `tissueid calibrate-frame` measures the frame.",
    ),
}
_COHORT = {
    "speed_confounded": Advice(
        "A difference between speeds may be one between specimens.", "Test every specimen at every speed."
    ),
    "population_not_converged": Advice(
        "Intervals of the population are rough.", "Run again, or add specimens."
    ),
    "specimen_outlier": Advice(
        "It counts less with heavy tails, and in full with normal ones.", "Look at its recordings, keep it."
    ),
    "likelihood_smoothed": Advice(
        "The specimen's posterior hardly reaches the population; its share is approximate.",
        "Fit that specimen with more --draws.",
    ),
    "draws_floored": Advice(
        "Such a draw lies far from the others, in the logarithm.",
        "Look at that specimen: bounds, or a poor contact point.",
    ),
    "population_not_passive": Advice(
        "New specimens are drawn from the passive part of the population.", "Nothing, where few are refused."
    ),
    "covariate_missing": Advice(
        "Those specimens say nothing about the effect of the covariate.", "State it for all."
    ),
}
FLAG_ADVICE: Mapping[str, Advice] = MappingProxyType({**_FILE, **_SAMPLES, **_SEGMENTS, **_FIT, **_COHORT})
