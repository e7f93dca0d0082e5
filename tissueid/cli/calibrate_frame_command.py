"""``tissueid calibrate-frame``."""

from __future__ import annotations

from collections.abc import Iterator

from tissueid.cli.flags import FILE, PATH, OutputFlags, argument, option, subcommand
from tissueid.cli.output import checked, note, tell, write_output
from tissueid.cli.reading import ReadingFlags, read_all, read_options
from tissueid.documents.folder import Frame


class _CalibrateFrameFlags(ReadingFlags, OutputFlags):
    paths: tuple[str, ...] = argument(required=True, type=PATH)
    output: str = option("Frame file to write.", "-o", type=FILE, default="frame.json")


@subcommand("calibrate-frame", "rigid.csv", "rigid-1.csv rigid-2.csv -o lab_data/frame.json")
def command(flags: _CalibrateFrameFlags) -> int:
    """Measure how far machine, load cell and fixture give, from recordings of a rigid block.

    Press the tip on steel, several times, to the largest force of the tests. Every loading counts; several
    show how repeatable the frame is. fit takes the deflection off the displacement where study.toml names
    the file, under [calibration]: frame = "frame.json".
    """
    from tissueid.store.files import json_bytes
    from tissueid.study.calibrate_frame import calibrate_frame

    trials = list(read_all(flags.paths, read_options(flags)))
    written, document = checked(calibrate_frame(trials), "frame", Frame, where=flags.output)
    write_output(flags.output, json_bytes(written))
    tell(flags, written, _lines(document))
    note(f"wrote {flags.output}", quiet=flags.quiet)
    return 0


def _lines(document: Frame) -> Iterator[str]:
    from tissueid.report.wording import counted

    top = document.range_N[1]
    yield f"{counted(document.loadings, 'loading')} to {top:.4g} N"
    yield f"stiffness above {top / 2:.3g} N: {document.stiffness_N_per_mm:.4g} N/mm"
    yield "force [N]   deflection [mm]   sd [mm]"
    for force, give, sd in zip(document.force_N, document.deflection_mm, document.sd_mm, strict=True):
        yield f"{force:9.4g}   {give:15.5f}   {sd:7.5f}"
    if document.repeatability_sd_mm is None:
        yield "one loading: a repeatability of 5 % was assumed; record several to know it"
