"""A plan as a document, and its recommended protocol as files to work with: study, test sheet, recipe."""

from __future__ import annotations

import csv
import io
from dataclasses import asdict
from typing import Any

import numpy as np

from tissueid.design.machine import Machine
from tissueid.design.plan import Against, Judged, Plan
from tissueid.design.precision import Asked, Indentation
from tissueid.design.tissues import Tissues
from tissueid.documents import members, plain
from tissueid.documents.design import Indentation as Told
from tissueid.documents.design import Number, Planned, Precision, Protocol, Tissue
from tissueid.model.channels import ChannelModel
from tissueid.model.kelvin_voigt import STATIC_DEGREE
from tissueid.report.inspect_decisions import toml_value
from tissueid.synth import Branch, Hold, Log, Move, Recipe, dump_recipe

#: Rest, in longest relaxation times, after which a tissue counts as recovered.
RECOVERED = 5.0
#: Relaxation times below so many samples are flagged by the fit.
SAMPLES_A_TIME = 2.0


def remarks_on(best: Judged, machine: Machine, tissues: Tissues, asked: Asked) -> list[str]:
    """Sentences on the recommended protocol, the gravest first."""
    out = []
    tau, step = float(tissues.tau_s.min(initial=np.inf)), best.setting.step_s
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


#: Limits that were asked for.
LIMITS = (
    "assurance", "max_depth_mm", "max_force_N", "budget_s", "recovery_s", "setup_s", "repeats", "max_logs",
    "gain_sd", "time_sd",
)  # fmt: skip


def _protocol(one: Judged, asked: Asked, specimens: int) -> Protocol:
    rows = zip(one.protocol.items(), one.log_seconds, one.peak_N, strict=True)
    found = zip(asked.wants, one.median, one.assured, strict=True)
    return Protocol(
        reached=one.reached,
        seconds=one.seconds,
        total_seconds=specimens * one.seconds,
        logs=one.logs,
        setting=Planned(**members(one.setting, Planned)),
        indentations=tuple(
            Told(test.words, test.speed_mm_min, test.depth_mm, test.hold_s, count, seconds, peak)
            for (test, count), seconds, peak in rows
        ),
        precision=tuple(Precision(want.name, want.share, median, assured) for want, median, assured in found),
        worst=one.worst,
    )


def _tissue(tissues: Tissues) -> Tissue:
    model, numbers = tissues.model, []
    for name, values in tissues.numbers().items():
        low, middle, high = np.quantile(values, (0.025, 0.5, 0.975))
        numbers.append(Number(name, middle, low, high))
    order = (model.name, model.branches, model.stiffness_degree, model.depth_mm)
    return Tissue(tissues.name, tissues.words, tissues.theta.shape[0], *order, tuple(numbers))


def design_document(
    plan: Plan,
    machine: Machine,
    tissues: Tissues,
    asked: Asked,
    *,
    given: Against | None = None,
    specimens: int = 1,
) -> dict[str, Any]:
    """The document of ``schemas/design.schema.json``."""
    return {
        "schema": "tissueid/design/1",
        "tissue": plain(_tissue(tissues)),
        "machine": asdict(machine),
        "asked": {
            "wants": plain(asked.wants),
            "interval": "total" if asked.total else "statistical",
            **{key: getattr(asked, key) for key in LIMITS},
            "specimens": specimens,
        },
        "verdict": {
            "reached": plan.best.reached,
            "limits": plain(plan.limits),
            "remarks": remarks_on(plan.best, machine, tissues, asked),
        },
        "protocols": plain([_protocol(one, asked, specimens) for one in plan.ranked]),
        "against": given
        and {
            "name": given.name,
            "obstacle": given.obstacle or None,
            "protocol": given.judged and plain(_protocol(given.judged, asked, specimens)),
        },
        "front": [
            {"factor": factor, **plain(_protocol(one, asked, specimens))} for factor, one in plan.front
        ],
        "work": {"paths": plan.paths, "protocols": plan.protocols},
    }


#: The study file's schema.
STUDY_SCHEMA = "tissueid/study/1"
COLUMNS = (
    "number", "file", "protocol", "speed_mm_min", "depth_mm", "hold_s", "rate_Hz", "filter_s", "rest_after_s",
)  # fmt: skip


def session_order(best: Judged) -> list[tuple[Indentation, int]]:
    """Every log of a specimen in the order of the session, with the number of its repeat."""
    places = [
        ((repeat - 0.5) / count, position, test, repeat)
        for position, (test, count) in enumerate(best.protocol.items())
        for repeat in range(1, count + 1)
    ]
    return [(test, repeat) for _, _, test, repeat in sorted(places, key=lambda place: place[:2])]


def _file_name(test: Indentation, repeat: int) -> str:
    kind = f"hold{test.hold_s:g}s" if test.hold_s > 0.0 else "ramp"
    return f"{kind}-{test.depth_mm:g}mm-{test.speed_mm_min:g}mm-min-{repeat}.csv"


def test_sheet(best: Judged, asked: Asked) -> str:
    """The list of moves as CSV, one row a log."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    order = session_order(best)
    for number, (test, repeat) in enumerate(order, start=1):
        rest = asked.recovery_s if number < len(order) else 0.0
        moves = [f"{value:g}" for value in (test.speed_mm_min, test.depth_mm, test.hold_s)]
        channel = [f"{value:g}" for value in (best.setting.rate_Hz, best.setting.filter_s, rest)]
        writer.writerow([number, _file_name(test, repeat), test.words, *moves, *channel])
    return stream.getvalue()


test_sheet.__test__ = False  # type: ignore[attr-defined]


def study_text(best: Judged, machine: Machine, asked: Asked, *, title: str) -> str:
    """A study file with the channels and protocols that are planned, to be completed with the recordings."""
    setting = best.setting
    frame = machine.frame_stiffness_N_per_mm
    calibration = {
        "load_cell_capacity_N": machine.max_force_N,
        "sampling_Hz": setting.rate_Hz,
        "force_filter_s": setting.filter_s,
        "force_filter_s_sd": setting.filter_sd_s,
        "frame_stiffness_N_per_mm": frame,
        "frame_stiffness_N_per_mm_sd": None if frame is None else machine.frame_stiffness_N_per_mm_sd,
    }
    lines = [
        "# Study file of tissueid, planned by `tissueid design`: record test-sheet.csv, keep the recordings",
        "# beside this file, and add a table [[trial]] for each, as at the end. Correct what was otherwise.",
        f'schema = "{STUDY_SCHEMA}"',
        "",
        "[study]",
        f"title = {toml_value(title)}",
        f"machine = {toml_value(machine.name)}",
        "",
        "[calibration]",
        *(f"{key} = {value:.10g}" for key, value in calibration.items() if value is not None),
        "",
    ]
    for test, count in best.protocol.items():
        lines += [
            "[[protocol]]",
            f'name = "{test.words}"',
            f'kind = "{"ramp-hold" if test.hold_s > 0.0 else "ramp"}"',
            f"speed_mm_s = {test.speed_mm_s:.10g}",
            f"depth_mm = {test.depth_mm:g}",
            *([f"hold_s = {test.hold_s:g}"] if test.hold_s > 0.0 else []),
            f'notes = "{count} repeats a specimen, {asked.recovery_s:g} s of rest between logs"',
            "",
        ]
    test, repeat = session_order(best)[0]
    lines += [
        "# [[trial]]",
        f'# file = "{_file_name(test, repeat)}"',
        '# specimen = "specimen 1"',
        f'# protocol = "{test.words}"',
        "# run = 1",
    ]
    return "\n".join(lines) + "\n"


def has_recipe(model: ChannelModel) -> bool:
    """True of laws that a recipe can state: a static polynomial of degree 3 and exponentials beside it."""
    return model.viscous and model.static.polynomial and len(model.static.coefficients) == STATIC_DEGREE


def recipe_text(best: Judged, machine: Machine, tissues: Tissues, asked: Asked, *, name: str) -> str:
    """A recipe of the protocol on the middle tissue: for `tissueid synth` and `tissueid calibrate`."""
    model: ChannelModel = tissues.model
    static, stiffness, tau = model.split(tissues.middle)
    setting = best.setting
    correlated = setting.noise_correlation_s > 0.0
    logs = tuple(
        Log(
            f"log-{number}",
            (Move(test.depth_mm, test.speed_mm_min), *([Hold(test.hold_s)] if test.hold_s > 0.0 else [])),
            repeats=count,
        )
        for number, (test, count) in enumerate(best.protocol.items(), start=1)
    )
    recipe = Recipe(
        name=name,
        logs=logs,
        rate_Hz=setting.rate_Hz,
        static=tuple(float(a) for a in static),
        branches=tuple(
            Branch(tuple(float(k) for k in coefficients), float(time))
            for coefficients, time in zip(stiffness, tau, strict=True)
        ),
        sigma_N=0.0 if correlated else setting.noise_N,
        ar1_sigma_N=setting.noise_N if correlated else 0.0,
        ar1_phi=setting.phi,
        specimen="planned",
        cv_both=asked.gain_sd,
        force_filter_s=setting.filter_s,
    )
    heading = f"# The recommended protocol on the middle tissue, for machine {machine.name!r}.\n"
    return heading + dump_recipe(recipe)
