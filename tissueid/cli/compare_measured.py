"""``compare`` of what was measured: of recordings, or beside the fits of output folders."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tissueid.cli.output import echo, echo_json, note, write_output
from tissueid.cli.reading import read_in_order, read_options, segment_options
from tissueid.documents import typed
from tissueid.documents.contrast import MeasuredContrast, MeasuredNumber, MeasuredPair, Side
from tissueid.errors import UsageError

if TYPE_CHECKING:
    from tissueid.cli.compare_command import _CompareFlags
    from tissueid.documents.measured import Spread

#: Folders with one of these were written by a fit.
_RESULT = "identification.json"


def are_recordings(paths: Sequence[str]) -> bool:
    """True where the paths are recordings, all of them.

    Raises UsageError: recordings stand beside bundles or output folders.
    """
    raw = [path for path in paths if not _is_fit(Path(path.partition("::")[0]))]
    if raw and len(raw) < len(paths):
        msg = f"{raw[0]} is a recording and others are fits: compare recordings, or fits"
        raise UsageError(msg)
    return bool(raw)


def _is_fit(path: Path) -> bool:
    if path.suffix == ".h5" and not path.is_file():
        msg = f"{path}: there is no such bundle"
        raise UsageError(msg)
    return (path / _RESULT).is_file() if path.is_dir() else path.suffix == ".h5"


def compare_recordings(flags: _CompareFlags) -> int:
    """Say what recordings showed beside each other, no model: each path is one side."""
    from tissueid import __version__
    from tissueid.measured.comparison import measured_pairs
    from tissueid.store.files import json_bytes, plain_json

    if len(flags.paths) < 2:
        msg = "one side is nothing to compare: name a second recording or folder"
        raise UsageError(msg)
    sides = [(path, _measured(path, flags)) for path in flags.paths]
    written = {
        "schema": "tissueid/measured-contrast/1",
        "tissueid": __version__,
        "pairs": measured_pairs(sides),
    }
    if flags.output is not None:
        target = str(Path(flags.output).with_suffix(".json"))
        write_output(target, json_bytes(written))
        note(f"wrote {target}", quiet=flags.quiet)
    if flags.as_json:
        echo_json(written)
    elif not flags.quiet:
        for pair in typed(plain_json(written), MeasuredContrast).pairs:
            echo()
            for line in measured_pair_lines(pair):
                echo(line)
    return 0


def _measured(path: str, flags: _CompareFlags) -> Sequence[Spread]:
    """Measured pushes of the recordings of one path."""
    from tissueid.errors import InputError
    from tissueid.inspection import measured_of, segmented
    from tissueid.measured import spread
    from tissueid.result import Refusal

    options = segment_options(flags)
    found = []
    for item in read_in_order((path,), read_options(flags)):
        divided = item if isinstance(item, Refusal) else segmented(item, options=options)
        if isinstance(item, Refusal) or isinstance(divided, Refusal):
            refused = item if isinstance(item, Refusal) else divided
            assert isinstance(refused, Refusal)  # noqa: S101 -- one of the two is
            raise InputError(refused.code, refused.message, path=refused.path, sheet=refused.sheet)
        found.append(measured_of(item, divided))
    return spread(found)


def measured_pair_lines(pair: MeasuredPair) -> list[str]:
    """Lines of one pair: the numbers that may be compared, then those that may not, with the reason."""
    lines = [f"{pair.one} and {pair.other}: measured, no model"]
    known = [row for row in pair.numbers if row.reason is None]
    width = max((len(_name(row)) for row in known), default=0)
    for row in known:
        one, other = _value(row.one), _value(row.other)
        ratio = "" if row.ratio is None else f"ratio {row.ratio:.3g}"
        lines.append(f"  {_name(row):<{width}}  {one:>14}  {other:>14}  {ratio}".rstrip())
    refused = [row for row in pair.numbers if row.reason is not None]
    for reason in dict.fromkeys(row.reason for row in refused):
        names = ", ".join(_name(row) for row in refused if row.reason == reason)
        lines.append(f"  not compared: {names}: {reason}")
    return lines


def _name(row: MeasuredNumber) -> str:
    time = "" if row.time_s is None else f" at {row.time_s:g} s"
    unit = "" if row.unit == "1" else f" [{row.unit}]"
    number = f", program {row.program}" if row.program > 1 else ""
    number += f", hold {row.hold}" if row.hold > 1 else ""
    return f"{row.name.replace('_', ' ')}{time}{number}{unit}"


def _value(side: Side) -> str:
    from tissueid.digits import with_error

    return with_error(side.mean, side.sd)
