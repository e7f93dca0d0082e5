"""Everything tissueid may say about a recording or a fit, in one table.

A flag is a warning with a stable code, a plain sentence and the numbers behind it.  Codes are listed here
once, with title, meaning, consequence and way out; ``schemas/flag.schema.json`` and ``docs/flags.md`` are
written from this table by ``scripts/write-docs``.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

#: Words of a warning, its way out included.
MOST_WORDS = 25
#: Remedy of a flag that asks for nothing.
NOTHING = "Nothing."


class FlagKind(NamedTuple):
    """Meaning of a flag for a result, and the way out."""

    title: str  # subject of it, without a verb
    means: str  # for the report and the documentation
    follows: str  # for the result
    remedy: str  # for the user, in ten words; :data:`NOTHING` where it only informs
    many: str  # words about several recordings or specimens that carry it, behind their number
    #: Verdict that a recording with it gets beside the machine: ``look``, or ``repeat``; most ask for none.
    beside: Literal["", "look", "repeat"] = ""


# fmt: off
_SERIOUS = {
    "no_decimals": FlagKind("Decimals", "no number of the recording has decimals: were decimal marks lost?",
        "If a decimal mark was lost, numbers are too large by a power of ten.",
        "Export again with more digits, or state --units.", "may have lost decimal marks", "repeat"),
    "clipped_force": FlagKind("Clipped force",
        "the force stands at its extreme for several samples: clipped load cell",
        "The true peak was higher; samples at the limit are not fitted.",
        "Take a larger load cell, or less depth.",
        "have a clipped force", "repeat"),
    "too_few_samples": FlagKind("Samples", "too few samples to segment or fit",
        "There is nothing to segment or fit.", "Sample faster, let the test run, or state other times.",
        "have too few samples", "repeat"),
    "no_contact": FlagKind("No contact", "no contact between tool and tissue was found",
        "The recording is not fitted.", "Start nearer, push deeper, or state --contact.",
        "show no contact", "repeat"),
    "no_ramp": FlagKind("No ramp", "no loading ramp was found", "There is no loading to fit.",
        "Look at it with `tissueid inspect --html`.", "show no ramp", "repeat"),
    "misfit": FlagKind("Misfit",
        "the residuals show what model and noise can't make: no interval can be believed",
        "The model is wrong in a way the residuals show; intervals would be of a wrong model.",
        "Look at that check; add a branch, state the machine.", "contradict the model"),
    "not_converged": FlagKind("Convergence", "Levenberg-Marquardt did not converge",
        "Levenberg-Marquardt gave up; the result of the search stands unconfirmed.",
        "Simplify: fewer branches, --stiffness-degree 0.", "did not converge"),
    "optimisers_disagree": FlagKind("Two optima",
        "Levenberg-Marquardt and variable projection ended at different optima",
        "At least one did not find the best fit; the lower sum of squares was kept. Quote nothing yet.",
        "Simplify: fewer branches, --stiffness-degree 0.", "have two optima"),
    "interval_withheld": FlagKind("Interval withheld",
        "value and intervals do not agree: no interval is given",
        "The number stands without an interval: it may be far from what other data would give.",
        "Add logs, state the machine, or take --branches 1.", "have a value without interval"),
    "logs_apart": FlagKind("Logs fitted alone",
        "logs fitted alone have a number elsewhere: its interval reaches there",
        "Pooled logs share what each of them, taken alone, shows otherwise.",
        "Fit the sites apart (study.toml: specimen), or take more repeats.",
        "have numbers that logs fitted alone have elsewhere"),
    "copied_recording": FlagKind("Copies", "files of a specimen are the same to the byte",
        "One recording counts as two: intervals are too narrow, and the spread between logs too small.",
        "Take the copies out of the folder.", "hold copies of a recording"),
    "quantised_force": FlagKind("Force resolution", "the force has few distinct levels for its range",
        "Small changes of the force are lost; relaxation may look like steps.",
        "Take a smaller load cell, or export more digits.", "have a force of few levels", "look"),
    "single_speed": FlagKind("One speed",
        "one speed and no hold: only the ramp's shape tells viscosity from static stiffness",
        "Viscosity and static stiffness share one curve; either may hold the other's share.",
        "Test at a second speed, or hold.", "have one speed and no hold"),
    "machine_implausible": FlagKind("Machine", "the law only fits behind a machine that is unlikely",
        "What the law can't follow is put down to the machine; depth and force of the tissue are wrong.",
        "Take another law, or state the machine in [calibration].", "only fit behind an unlikely machine"),
    "population_not_converged": FlagKind("Convergence",
        "chains over the population did not converge: its intervals are rough",
        "Intervals of the population are rough.", "Run again, or add specimens.",
        "have rough intervals of the population"),
    "speed_confounded": FlagKind("Speed and specimen",
        "speeds were tested on specimens of their own: speed can't be told from specimen",
        "A difference between speeds may be one between specimens; no effect of speed can be claimed.",
        "Test every specimen at every speed.", "have speeds of their own"),
}
_CAUTION = {
    "unit_overridden": FlagKind("Unit by hand",
        "the file states another unit than the user did; the user's was taken",
        "The result is as right as the unit that was stated by hand.",
        "Check the unit against the machine.", "state another unit than was taken"),
    "sign_assumed": FlagKind("Sign",
        "compression could not be told from tension; the dominant excursion was taken",
        "If the guess is wrong the recording is read upside down.",
        "State --compression positive or negative.", "leave the sign of compression open"),
    "tension": FlagKind("Tension", "the force grows against the travel or the specimen is pulled",
        "A contact model does not describe pulling.", "Check the mounting, or state --compression.",
        "look like tension"),
    "rendered": FlagKind("No measurement",
        "the recording is the log of a rendered session: a force law, no measurement",
        "A fit returns the law that was rendered. It says nothing new of the tissue.",
        "Use it to check a session, not to identify.", "are rendered, not measured"),
    "rupture": FlagKind("Rupture",
        "the force collapses while the tool moves on: the tissue broke or the tool slipped",
        "The fit ends there: what follows is another specimen; `tissueid rupture` studies it.",
        "Correct it by [[override]] of study.toml, if untrue.", "show a rupture"),
    "doubtful_rupture": FlagKind("Rupture?",
        "most of the force is lost within 0.1 s of a stop: relaxation, or a rupture?",
        "The hold is kept, as if the tissue were whole.", "Look at the curve: --exclude leaves it out.",
        "lose most of their force at a stop", "look"),
    "speed_differs": FlagKind("Speed", "the ramp runs at another speed than the file states",
        "The measured speed counts; the machine did not do what its header says.",
        "Check the header and the time column.", "run at another speed than stated"),
    "adhesion": FlagKind("Adhesion", "tissue pulls at the tool as it leaves",
        "Loading and holds are fitted; the model has no pull, so unloading does not follow.",
        "Wet or powder the tip, or leave the retract out.", "pull at the tool as it leaves"),
    "slip": FlagKind("Slip",
        "the force falls a little on a ramp and recovers: the tool or the grip slipped",
        "The fit follows the force through it.", "Look at the grip: --exclude leaves it out.",
        "slip on a ramp"),
    "not_identified": FlagKind("Not identified", "the data do not determine this parameter",
        "No value is given: other values fit these data as well.",
        "Test a second speed, hold longer, or sample faster.", "leave parameters undetermined"),
    "discrepancy": FlagKind("Misfit beside the noise",
        "the model misses more than the measured noise; intervals were widened for it",
        "The model is simpler than the tissue; its parameters describe this program, not any other. "
        "Intervals count several samples as one.", "Look at the largest residual; add a branch.",
        "are missed by more than the noise"),
    "sampler_not_converged": FlagKind("Sampler",
        "the sampler stopped before its rule was met: intervals are rough",
        "Intervals are rough, or there are none; stating the machine in [calibration] narrows what a "
        "total interval has to search.", "Take fewer --branches, or state the machine.",
        "have rough intervals"),
    "unloading_disagrees": FlagKind("Unloading", "taking unloading in moves a relaxation time or K",
        "One law does not hold on both ways: a contact that shrinks, adhesion or damage is another law.",
        "Quote the fit of loading and holds, without --unloading.", "have an unloading of another law"),
    "unloading_not_settled": FlagKind("Unloading", "the fit of unloading, or behind loops, did not converge",
        "Its numbers are rough.", "Fit without --unloading; rest longer between loops and test.",
        "have an unloading that did not settle"),
    "aborted_ramp": FlagKind("Aborted test", "the recording ends, or unloads, before the ramp is over",
        "The recording shows less depth than was asked for.", "Repeat the test.",
        "end before their ramp does", "repeat"),
    "jump": FlagKind("Leap", "travel, or the force of a tool that stands or is in air, leaps and stays there",
        "What happened in between is missing: another recording may go on, or the channel was zeroed.",
        "Cut it by start_s or end_s of study.toml.", "leap between two samples", "look"),
    "gap": FlagKind("Gap", "the log has a gap in time",
        "What the force did in the gap is not known; the model runs through it on an interpolated path.",
        "Log at a constant rate, or leave the recording out.", "have gaps in time", "look"),
    "spike": FlagKind("Outliers", "single samples, or those of a lost signal, stand far off their neighbours",
        "Single samples may pull the fit and look like misfit; those of a lost signal are left out.",
        "Look for a bad cable.", "have single samples far off", "look"),
    "zero_dt": FlagKind("Time stamps", "two samples carry the same time",
        "The samples share one instant; speeds there mean nothing.", "Export time with more digits.",
        "repeat times"),
    "held_channel": FlagKind("Held readings",
        "a channel is read more slowly than rows are written, and repeats its reading between",
        "Rows that repeat a reading are left out: what happened between two readings was not seen.",
        "Log that channel faster, or each at its own rate.", "repeat the readings of a channel"),
    "commanded_displacement": FlagKind("Commanded displacement",
        "the displacement is free of noise and lag: commanded, not measured?",
        "No crosshead turns so sharply: where the tool really was is not recorded; lag and give of the "
        "machine become tissue.", "Export the measured displacement.",
        "may hold the commanded displacement"),
    "below_resolution": FlagKind("Resolution",
        "displacement or force changes by few of its resolution steps",
        "The channel says little more than its steps.", "Take a finer sensor, or go deeper.",
        "go through few resolution steps", "look"),
    "below_cell_range": FlagKind("Load-cell range",
        "the force is small against the load cell's verified range",
        "The load cell's class holds only in its verified range; below it the force may be off by more.",
        "Take a smaller cell, or state verified_from_N.",
        "stay below the load cell's verified range", "look"),
    "cantilever_bending": FlagKind("Cantilever", "the travel holds the bending of the cantilever",
        "The tip went less deep than the travel says, so that the tissue looks softer.",
        "State frame_stiffness_N_per_mm in [calibration] of study.toml.",
        "hold the bending of a cantilever"),
    "contact_uncertain": FlagKind("Uncertain contact",
        "the contact point is known only to a large part of the depth",
        "Depth, and what grows with it, is uncertain by that much; intervals know of it.",
        "Start in air; approach at the ramp's speed.", "have an uncertain contact", "look"),
    "baseline_drift": FlagKind("Load-cell zero", "the force drifts while the tool is in air",
        "The zero of the force is uncertain by the drift.", "Let the load cell warm up, then zero it.",
        "drift in air", "look"),
    "drag": FlagKind("Drag", "the force leaps as the tool sets off in air, and stays",
        "The drag is taken off all forces; a tool that stands may have less of it.",
        "Free the tool from what it rubs at.", "are dragged at", "look"),
    "bound_active": FlagKind("Passivity", "a passivity bound is active at the optimum",
        "The tissue that fits best stands at the edge of what is passive; its error is not symmetric.",
        "Check the contact point; trust sampled intervals.", "stand at the passivity bound"),
    "tau_exceeds_window": FlagKind("Short hold", "a relaxation time is longer than a third of its window",
        "The hold ended before this relaxation did; its time is an extrapolation. A load cell that drifts "
        "looks the same.", "Hold three times as long.", "relax longer than was held"),
    "tau_below_resolution": FlagKind("Sampling", "a relaxation time is shorter than two sampling intervals",
        "The branch is a jump of the force at this rate; its time is not measured.",
        "Sample ten times faster, or quote the viscosity alone.", "relax faster than was sampled"),
    "one_speed_ratio": FlagKind("One speed ratio",
        "no sample is slower than contact began: static force and damping are one number",
        "Static coefficient and restitution are withheld; their product k (1 + chi) is known.",
        "Record a hold or the unloading too.", "leave static force and damping one number"),
    "interval_open": FlagKind("Open interval",
        "the interval of a relaxation time runs into the bound of its range",
        "The data bound the relaxation time on one side only.",
        "Too short: sample faster. Too long: hold longer.", "have a relaxation time with an open interval"),
    "amplitude_small": FlagKind("Small relaxation",
        "the relaxing force is below what its noise lets one time", "The relaxing force drowns in noise.",
        "Go faster or deeper, or repeat to average.", "relax by less than noise lets one time"),
    "form_dependent": FlagKind("Form of the law",
        "the share of F_s and K, or the relaxation time, rests on the form of the law",
        "Of one speed and one depth, the split between F_s and K at smaller depths is the polynomials', "
        "not the data's; a relaxation time that follows the hold is one of that window.",
        "Test a second speed or depth.", "have numbers that rest on the form of the law"),
    "split_assumed": FlagKind("Split of F_s and K",
        "K is taken as constant: nothing here tells it from one that varies with depth",
        "a1, a2, a3, K and viscosity are those of a constant K; their intervals hold those of one that is "
        "linear in depth, curves, bands and draws do not. F_s at the full depth and relaxation times do not "
        "rest on it.",
        "Test a second speed or depth.", "rest on a constant K"),
    "window_dependent": FlagKind("Window",
        "halving the window moves the relaxation time by more than a fifth",
        "The relaxation is not one exponential; its time depends on where one looks.",
        "Quote the window beside the time, or add a branch.",
        "have a relaxation time that depends on its window"),
    "one_tau_inadequate": FlagKind("One exponential", "one relaxation time does not describe the hold",
        "One exponential leaves structure in the hold.",
        "Quote two or three, or let --branches auto choose.", "relax in more than one time"),
    "residual_large": FlagKind("Large residual",
        "the largest residual is more than a twentieth of the force range",
        "Somewhere the model is off by more than 5 %.", "Look where, in the residuals of the report.",
        "leave a residual above 5 % of the force range"),
    "residual_correlated": FlagKind("Correlated residual",
        "neighbouring residuals are correlated: noise with memory, or a lacking model",
        "White-noise standard errors are too small; sampled intervals know the memory of the noise.",
        "Trust sampled intervals, not standard errors.", "leave correlated residuals"),
    "contact_loss_misfit": FlagKind("Contact loss",
        "the load cell shows a force while the model has the tool in air",
        "Tissue sticks, or recovers otherwise than the model says.", "Trust loading only.",
        "show a force in air"),
    "contact_loss_ambiguous": FlagKind("Contact loss",
        "after the tool lets go the surface has several force-free positions",
        "Unloading is passive, but not unique, once the tool has left.", "Do not render fast retracts.",
        "have several free surfaces after contact loss"),
    "gain_spread": FlagKind("Spread of the trials", "logs of one specimen differ much in stiffness",
        "Sites or moments differ; the shared tissue is an average.", "Fit them as specimens of their own.",
        "have logs of different stiffness"),
    "relaxation_spread": FlagKind("Spread of the trials", "logs of one specimen differ much in relaxation",
        "Sites or moments differ; the shared time is an average.", "Fit them as specimens of their own.",
        "have logs of different relaxation"),
    "order_effect": FlagKind("Order of the tests", "force changes with the order of the tests",
        "Something changes while you test: drying, damage, recovery.",
        "Precondition, and randomise the order.", "change with the order of the tests"),
    "repeated_site": FlagKind("Repeated site", "one site was tested more than once",
        "Later tests met tissue that had been tested.", "Leave rest, or change the site.",
        "were tested at one site again"),
    "not_preconditioned": FlagKind("Preconditioning", "the last cycles still change by 2 % or more",
        "The tissue was still changing; repeated tests will not agree.", "Precondition for more cycles.",
        "still change from cycle to cycle", "look"),
    "corner_slow": FlagKind("Slow stop", "the crosshead took long to stop",
        "Relaxation that is faster than the stop can't be seen.",
        "Use a stiffer controller, or a slower ramp.", "stop slowly"),
    "corner_overshoot": FlagKind("Overshoot", "displacement overshoots or rings where the ramp stops",
        "The fit follows the measured path, overshoot included.", "Tune the controller, if it is large.",
        "overshoot where the ramp stops", "look"),
    "prior_dominated": FlagKind("Prior", "a prior decides this more than the data do",
        "The number is mostly what was believed before.", "State the prior when quoting, or test more.",
        "are decided by a prior"),
    "modulus_out_of_range": FlagKind("Range of the modulus",
        "the modulus formula was used outside the range it was derived for",
        "The modulus is an extrapolation of its formula; the stiffness stands.",
        "Quote the stiffness, or press less deep.", "have a modulus outside its formula's range"),
    "poroelastic": FlagKind("Fluid flow", "relaxation may be fluid flow, not viscosity",
        "A relaxation time lies where fluid drains from under a contact of this size (a^2/D, D of 10⁻¹¹ "
        "to 10⁻⁸ m²/s); with another tip fluid flow slows with the square of its radius, viscosity does "
        "not.", "Repeat with a tip of another radius.", "may relax by fluid flow"),
    "unloading_left_out": FlagKind("Unloading",
        "samples after the tool first turned back took no part in the fit",
        "Only loading and holds are fitted.", "Add --unloading.", "have samples that were not fitted"),
    "specimen_outlier": FlagKind("Outliers", "a specimen is far from the others",
        "It counts less with heavy tails, and in full with normal ones.",
        "Look at its recordings, and keep it.", "are far from the others"),
    "covariate_missing": FlagKind("Missing covariate",
        "a covariate is not stated of all specimens; its mean was taken",
        "Those specimens say nothing about the effect of the covariate.", "State it for all.",
        "state no covariate"),
    "population_not_passive": FlagKind("Passivity",
        "specimens drawn from the population were not passive and were drawn again",
        "New specimens are drawn from the passive part of the population.",
        "Add specimens, where many are.", "were drawn again"),
}
_NOTE = {
    "not_a_specimen": FlagKind("No specimen",
        "a mean curve, a summary or a search for contact: no specimen",
        "It is shown, and takes no part in a fit.", "List it under [[trial]] of study.toml, if it is one.",
        "are no specimens"),
    "study_order": FlagKind("Order of the study",
        "the specimen alone would take another law or order than its study",
        "Its numbers are of the same law as those of the others, which predicts best over all of them.",
        "--orders own leaves each specimen its own.", "take the order of the study"),
    "units_assumed": FlagKind("Units", "the file states no unit for a column; mm, N or s was assumed",
        "If the unit is another, forces or depths are wrong by its factor, and so is every parameter.",
        "State it: --units force=kN, or in study.toml.", "state no unit for a column"),
    "normalised_axes": FlagKind("Normalised axes",
        "the recording is normalised (strain, stress): nothing here is in mm or N",
        "Parameters are in units of strain and stress and can't be rendered.",
        "Export displacement and force, to feel a tissue.", "are normalised"),
    "compliance_unknown": FlagKind("Machine",
        "frame compliance, force filter and time skew were not stated; taken as none",
        "A short relaxation time may be the machine's.", "State them in [calibration].",
        "leave the machine unstated"),
    "calibration_dominates": FlagKind("Calibration",
        "what is not known of the machine outweighs the noise of the recordings",
        "More tests will not narrow the total interval; knowing the machine will.",
        "State it in [calibration]; `tissueid calibrate-frame` measures a frame.",
        "are limited by the machine"),
    "model_undecided": FlagKind("Choice of the model", "the data do not decide between two models",
        "Another model would predict as well; parameters that differ between them are not settled.",
        "Add a second speed; --branches and --stiffness-degree fit one order.",
        "do not decide between models"),
    "preload": FlagKind("Preload", "the force at the start is above its noise: the tissue was preloaded",
        "Depth counts from the preloaded surface, not from the free one; tissue that had relaxed under "
        "it, slower than the ramp, was met further back. A load cell that was not zeroed looks the same.",
        "Start in air, or state --contact.", "start preloaded"),
    "starts_in_contact": FlagKind("Start in contact",
        "the recording starts in contact or within its noise: no samples in air",
        "Zero force and zero depth were not seen; the linear static term may be off.",
        "Start in air, or state --contact.", "start in contact"),
    "begins_moving": FlagKind("Start in motion",
        "the recording starts under a force while the tool moves: it came at that speed",
        "Contact is where that approach began; where the samples do not tell it from a preload that had "
        "relaxed, intervals hold both.", "Start the record in air.", "start in motion"),
    "no_hold": FlagKind("No hold", "no hold was found: there is nothing to relax",
        "Relaxation times come from the shape of ramps alone, and may not be identified.",
        "Hold at the largest depth, longer than tissue relaxes.", "show no hold"),
    "cut_row": FlagKind("End of the file", "the last row is incomplete and was left out",
        "One sample is missing; the export was probably cut short, and more may be.",
        "Export again, if the recording should be longer.", "end in an incomplete row"),
    "rows_skipped": FlagKind("Rows left out",
        "rows without numbers (comments, results) stand among the data and were left out",
        "Rows of text took no part; samples did.", "Look at those lines, if they were samples.",
        "hold rows that were left out"),
    "decision_overridden": FlagKind("Decided by hand", "the user decided this instead of the data",
        "The result follows your decision.", "Change it in study.toml, where it is wrong.",
        "follow a decision of the study"),
    "load_limit_stop": FlagKind("Load limit", "the ramp ended at a load limit, not at a depth",
        "The depth is not the one asked for; it is the measured one that counts.",
        "Raise the limit, if the depth is wanted.", "stop at a load limit"),
    "time_counted": FlagKind("Time", "no column is the time: it is counted by the stated sampling rate",
        "If the rate is another, relaxation times are wrong by its factor, and so are speeds.",
        "Export the time as well, or state --columns time=100Hz.", "have no column of time"),
    "column_choice": FlagKind("Choice of columns",
        "several columns could be the displacement or the force; one was taken by rule",
        "If the rule took the wrong column, every number is of the wrong quantity.",
        "State others with --columns, if that is wrong.", "have several columns that fit"),
    "undecoded_text": FlagKind("Encoding", "some header text could not be decoded; numbers are unaffected",
        "Only names and remarks of the header may look odd; numbers are unaffected.",
        "Export as UTF-8, if names look odd.", "have a header of uncertain encoding"),
    "several_steps": FlagKind("Several steps", "the recording has several ramp-and-hold steps",
        "Every step is fitted with one tissue.", NOTHING, "have several steps"),
    "cyclic": FlagKind("Cyclic test", "the recording is cyclic",
        "Loading is fitted; turns and loops are measured.", "With --unloading retracts are fitted.",
        "are cyclic"),
    "event_rows": FlagKind("Event rows",
        "extra samples stand close beside their neighbours, as written at segment changes",
        "They are counted as samples of next to no duration.", NOTHING,
        "have extra samples at changes of a segment"),
    "frame_corrected": FlagKind("Frame",
        "the deflection of machine and fixture was taken off the displacement",
        "Depths are the tissue's alone, as far as the frame is known.",
        "Measure it again with `tissueid calibrate-frame`, if in doubt.", "were corrected for the frame"),
    "preconditioned": FlagKind("Preconditioning", "the last cycles change by less than 2 %",
        "Cycles before the test settled; it is what one hopes for.", NOTHING,
        "settled in their last cycles"),
    "likelihood_smoothed": FlagKind("Smoothed likelihood",
        "population lies among few draws of a specimen: its likelihood was smoothed",
        "The specimen's posterior hardly reaches the population; its share is approximate.",
        "Fit them with more --draws.", "have a smoothed likelihood"),
    "draws_floored": FlagKind("Zero force",
        "a force or stiffness is zero in draws; it was set to a small share of its median",
        "Such a draw lies far from the others, in the logarithm.", "Look at bounds and contact point.",
        "have draws without force"),
}
# fmt: on

#: Gravity -> its flags; in each, and over all, those that do more harm come first.
HARM: Mapping[str, Mapping[str, FlagKind]] = {"serious": _SERIOUS, "caution": _CAUTION, "note": _NOTE}
#: Code -> its kind, that of most harm first.
FLAGS: Mapping[str, FlagKind] = {**_SERIOUS, **_CAUTION, **_NOTE}
_RANK = {code: rank for rank, code in enumerate(FLAGS)}
_LEVEL = {code: level for level, kinds in HARM.items() for code in kinds}


class Flag:
    """One remark: code, plain sentence, and the numbers behind it, which stand beside both in a file."""

    __slots__ = ("code", "message", "values")

    def __init__(self, code: str, message: str, values: Mapping[str, Any] = MappingProxyType({})) -> None:
        if code not in FLAGS:
            raise ValueError(f"unknown flag code {code!r}")
        self.code, self.message, self.values = code, message, dict(values)

    def __repr__(self) -> str:
        return f"Flag({self.code!r}, {self.message!r}, {self.values!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Flag) and repr(self) == repr(other)

    @classmethod
    def read(cls, document: Mapping[str, Any]) -> Flag:
        """Read one from its members; a code of a later version is kept."""
        flag = cls.__new__(cls)
        flag.values = dict(document)
        flag.code, flag.message = flag.values.pop("code"), flag.values.pop("message")
        return flag


def flag_level(code: str) -> str:
    """Gravity of a flag: ``serious``, ``caution`` or ``note``; one of a later version is a caution."""
    return _LEVEL.get(code, "caution")


def harm_rank(code: str) -> int:
    """Place of a flag among all, 0 for the worst; one of a later version stands behind those known."""
    return _RANK.get(code, len(_RANK))


def warning_line(code: str, message: str) -> str:
    """A flag in at most :data:`MOST_WORDS` words: what was seen, with its number, and the way out."""
    kind = FLAGS.get(code)
    remedy = "" if kind is None or kind.remedy == NOTHING else kind.remedy
    room = MOST_WORDS - len(remedy.split())
    words = message.rstrip(".?").split()
    seen = " ".join(words) if len(words) <= room else f"{' '.join(words[:room])} ..."
    return f"{seen}. {remedy}".rstrip() if remedy else seen
