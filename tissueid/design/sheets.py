"""The recommended protocol as files to work with: study.toml, a test sheet, a recipe to try it with.

The rounds of the test sheet are mixed: the repeats of every indentation are spread over the whole session, so
that drift and preconditioning do not pass for an effect of speed or depth.
"""

from __future__ import annotations

import csv
import io
from typing import Any

import tomlkit

from tissueid.design.information import Indentation
from tissueid.design.machine import Machine
from tissueid.design.plan import Judged
from tissueid.design.precision import Asked
from tissueid.design.tissues import Tissues
from tissueid.model.channels import ChannelModel
from tissueid.model.kelvin_voigt import STATIC_DEGREE
from tissueid.synth import Branch, Hold, Log, Move, Recipe, dump_recipe

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


def _quoted(text: str) -> str:
    """A text as TOML writes it."""
    return str(tomlkit.item(text).as_string())


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
    calibration: dict[str, Any] = {
        "load_cell_capacity_N": machine.max_force_N,
        "sampling_Hz": setting.rate_Hz,
        "force_filter_s": setting.filter_s,
    }
    if setting.filter_sd_s is not None:
        calibration["force_filter_s_sd"] = setting.filter_sd_s
    if machine.frame_stiffness_N_per_mm is not None:
        calibration["frame_stiffness_N_per_mm"] = machine.frame_stiffness_N_per_mm
        if machine.frame_stiffness_N_per_mm_sd is not None:
            calibration["frame_stiffness_N_per_mm_sd"] = machine.frame_stiffness_N_per_mm_sd
    lines = [
        "# Study file of tissueid, planned by `tissueid design`: record test-sheet.csv, keep the recordings",
        "# beside this file, and add a table [[trial]] for each, as at the end. Correct what was otherwise.",
        f'schema = "{STUDY_SCHEMA}"',
        "",
        "[study]",
        f"title = {_quoted(title)}",
        f"machine = {_quoted(machine.name)}",
        "",
        "[calibration]",
        *(f"{key} = {value:.10g}" for key, value in calibration.items()),
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
