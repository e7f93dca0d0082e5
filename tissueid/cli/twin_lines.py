"""``tissueid render --twin``: what a test machine finds at the grip of a device that renders a bundle."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

from tissueid.cli.flags import typed
from tissueid.cli.output import made_folder, note, progress_bar, tell, write_output
from tissueid.errors import refuse

if TYPE_CHECKING:
    from tissueid.cli.render_command import RenderFlags
    from tissueid.documents.twin import Row, Twin
    from tissueid.store.bundle import Bundle
    from tissueid.twin import Program

#: Options that a twin has a use for.
_TAKEN = {
    "bundle", "twin", "against", "script", "felt", "out", "force_scale", "motion_scale", "yes", "no_browser",
    "quiet", "verbose", "as_json",
}  # fmt: skip
#: Program without a recording: pushes at the slowest and the fastest identified speed, held.
HOLD_S, SLOWEST_MM_S, FALL_BACK_S = 5.0, 0.5, 60.0


def twin(flags: RenderFlags) -> int:
    """Run the twin of a bundle, write it, print it."""
    from tissueid.documents import plain
    from tissueid.ingest import read_trials
    from tissueid.notebook import svg_file
    from tissueid.report.twin_page import render_twin
    from tissueid.store.bundle import load_bundle
    from tissueid.store.files import json_bytes
    from tissueid.twin import Setup, run_twin, twin_drawing

    said = typed(*(one.name for one in fields(flags) if one.name not in _TAKEN))
    if said or flags.bundle is None:
        words = f"leave out {', '.join(said)}" if said else "name a BUNDLE"
        refuse(f"--twin takes a bundle, --against RECORDING or --script, and --out: {words}")
    bundle = load_bundle(flags.bundle)
    bundle.require_renderable()
    felt = None if flags.felt is None else read_trials(flags.felt)[0]
    asked = Setup(_program(flags, bundle), flags.force_scale, flags.motion_scale, felt)
    out = made_folder(flags.out or flags.bundle.parent / "twin", "choose another place with --out")
    with progress_bar(show=not flags.quiet) as progress:
        twinned = run_twin(bundle, flags.bundle, asked, out, progress)
    write_output(str(out / "twin.json"), json_bytes(plain(twinned.found)))
    write_output(str(out / "twin.svg"), svg_file(twin_drawing(twinned)))
    write_output(str(out / "twin.html"), render_twin(twinned).encode())
    tell(flags, plain(twinned.found), twin_lines(twinned.found))
    note(f"wrote {out}/twin.html, twin.json, twin.svg, and the recordings at the grips", quiet=flags.quiet)
    if flags.against is not None:
        seen = f"tissueid view {out / 'felt.h5'} --beside {flags.against}"
        note(f"{seen} plays it beside the recording", quiet=flags.quiet)
    if flags.out is None:
        note(f"tissueid report {flags.bundle.parent} takes it into the report", quiet=flags.quiet)
    return 0


def _program(flags: RenderFlags, bundle: Bundle) -> Program:
    """A recording's travel, a script, or pushes over the identified speeds."""
    from tissueid.ingest import read_trials
    from tissueid.rendering.session_plan import read_script
    from tissueid.twin import program_of_recording, program_of_script

    if flags.against is not None:
        return program_of_recording(read_trials(flags.against)[0], bundle.depth_mm)
    if flags.script is not None:
        return program_of_script(read_script(flags.script))
    depth, (slow, fast) = 0.9 * bundle.depth_mm, bundle.speeds_mm_s
    slow = max(slow, SLOWEST_MM_S, depth / FALL_BACK_S)
    strokes = [f"indent {depth:.3g} mm at {60.0 * fast:.4g} mm/min; hold {HOLD_S:g} s"]
    if slow < 0.9 * fast:
        back = f"retract at {60.0 * fast:.4g} mm/min; hold {HOLD_S:g} s"
        strokes += [back, f"indent {depth:.3g} mm at {60.0 * slow:.4g} mm/min; hold {HOLD_S:g} s"]
    return program_of_script(read_script("; ".join(strokes)))


def twin_lines(found: Twin) -> list[str]:
    """Numbers that went in and came out, a device after another."""
    from tissueid.twin import MACHINE

    lines = [
        f"{found.specimen}  {found.model}, {found.program}",
        f"scale  felt force = tissue/{1.0 / found.force_scale:.4g}, motion x{found.motion_scale:g}",
    ]
    for one in found.devices:
        beside = "" if one.nrmsd_recording is None else f", the recording by {_percent(one.nrmsd_recording)}"
        missed = f"force off the law by {_percent(one.nrmsd_model)} of its range{beside}"
        could = "could" if one.noticeable > 1.0 else "could not"
        most = f"{max(one.noticeable, 0.01):.2g} just-noticeable differences at most (Jones 1989)"
        refit = "" if one.fit_nrmsd is None else f"; refit NRMSD {_percent(one.fit_nrmsd)}"
        lines += ["", f"{one.device}: {missed}{refit}", f"  a hand {could} tell: {most}"]
        lines += [f"  {_row(row)}" for row in one.rows]
    off = _percent(found.unseen.nrmsd_model)
    real = any(one.device == MACHINE for one in found.devices)
    lines += [
        "",
        f"at {found.unseen.speed_mm_s:.3g} mm/s, of no recording: emulated Falcon off the law by {off}",
        "No real device has confirmed this: the Falcon is emulated, its counts and delay stated"
        + (", and those of your device taken to be the same." if real else "."),
    ]
    return lines


def _row(row: Row) -> str:
    went, came = _said(row.went_in, row.went_in_ci95), _said(row.came_out, row.came_out_ci95)
    unit = "" if row.unit == "1" else f" {row.unit}"
    if row.verdict == "not identified":
        return f"{row.symbol:<6} not identified in the bundle"
    if row.verdict == "destroyed":
        return f"{row.symbol:<6} in {went}{unit}, destroyed by counts and delay"
    off = ""
    if row.verdict == "outside" and row.went_in and row.came_out is not None:
        off = f" by {_percent(abs(row.came_out / row.went_in - 1.0))}"
    return f"{row.symbol:<6} in {went}{unit}, out {came}, {row.verdict}{off}"


def _said(value: float | None, ci95: tuple[float, float] | None) -> str:
    if value is None:
        return "none"
    return f"{value:.4g}" + ("" if ci95 is None else f" [{ci95[0]:.4g}, {ci95[1]:.4g}]")


def _percent(share: float) -> str:
    return "less than 0.001 %" if share < 1e-5 else f"{100.0 * share:.2g} %"
