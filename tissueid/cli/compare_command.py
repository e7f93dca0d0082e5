"""``tissueid compare``: fits beside each other, or what was measured."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tissueid import __version__
from tissueid.cli.flags import ABOVE_0, PATH, OutputFlags, argument, option, subcommand
from tissueid.cli.flags import typed as typed_flags
from tissueid.cli.output import checked, made_folder, note, progress_bar, tell, write_output
from tissueid.cli.reading import ReadingFlags, read_all, read_options, segment_options
from tissueid.digits import with_error
from tissueid.documents import plain, typed
from tissueid.documents.contrast import Contrast, MeasuredContrast, MeasuredNumber, MeasuredPair
from tissueid.errors import UsageError, refuse
from tissueid.result import Refusal, in_units
from tissueid.store.files import bundle_names, json_bytes, time_now

if TYPE_CHECKING:
    from tissueid.contrast.decision import Compared
    from tissueid.documents.measured import Spread
    from tissueid.store.bundle import Bundle
    from tissueid.store.posteriors import StoredPosterior
    from tissueid.trial import Axes

#: Clamp of the simulated device and of a calibrated one at its default [N].
CLAMP_N = 5.0


class _CompareFlags(ReadingFlags, OutputFlags):
    # fmt: off
    paths: tuple[str, ...] = argument(required=True, type=PATH)
    interval: Literal["statistical", "total"] | None = option(
        "statistical holds the machine at each fit's own estimate of it: for machines that are stated.",
        show_default="total of output folders, statistical of bundles",
    )
    clamp: float = option(
        "Largest force of the device at which a hand would feel them.",
        type=ABOVE_0, default=CLAMP_N, metavar="N",
    )
    output: str | None = option(
        "Folder for contrast.json and, of fits, contrast.html; or NAME.json, and NAME.html beside it.",
        "-o", type=PATH,
    )
    # fmt: on


@subcommand(
    "compare",
    "out/bundle-kidney.h5 out/bundle-liver.h5",
    "before/ after/",
    "out -o compared",
    "slow.csv fast.csv",
)
def command(flags: _CompareFlags) -> int:
    """Say whether identified tissues differ, by how much, and whether a hand could feel it.

    PATHS are bundles, or output folders of which every specimen is taken. Forces at depths and speeds that
    all were identified at are tested together, pair by pair; numbers stand beside each other with the
    probability that one is larger, and of output folders what was measured, no model.

    PATHS may be recordings or folders of them instead, each one side: what was measured stands beside each
    other, no model. A number that depends on the ramp is compared within one program only.
    """
    raw = [path for path in flags.paths if not _is_fit(Path(path.partition("::")[0]))]
    if raw and len(raw) < len(flags.paths):
        refuse(f"{raw[0]} is a recording, or none, and others are fits: compare recordings, or fits")
    names = ("interval", "clamp") if raw else (one.name for one in fields(ReadingFlags))
    for said in typed_flags(*names):
        kind, other = ("fits", "recordings") if raw else ("recordings", "fits")
        refuse(f"{said} is for {kind}, and {flags.paths[0]} is one of {other}: leave it out")
    if raw:
        return compare_recordings(flags)
    from tissueid.contrast.decision import contrast_document
    from tissueid.measured.spread import measured_pairs

    bundles = any(Path(path).is_file() for path in flags.paths)
    interval = flags.interval or ("statistical" if bundles else "total")
    both = [tissue for path in flags.paths for tissue in _tissues(Path(path), interval)]
    if len(both) < 2:
        refuse("one tissue is nothing to compare: name a second bundle or output folder")
    tissues = _apart([tissue for tissue, _ in both])
    measured = measured_pairs(
        [(tissue.name, rows) for tissue, (_, rows) in zip(tissues, both, strict=True) if rows]
    )
    try:
        with progress_bar(show=not flags.quiet) as progress:
            found = contrast_document(tissues, clamp_N=flags.clamp, progress=progress)
    except UsageError:
        # models that share no speed can't be compared; what was measured at any time may
        if not flags.as_json:
            tell(flags, None, _measured_lines(typed(plain(measured), tuple[MeasuredPair, ...])))
        raise
    whole = found | ({"measured": measured} if measured else {})
    written, document = checked(whole, Contrast, where="contrast.json")
    if flags.output is not None:
        _write(written, document, _named(flags.output), quiet=flags.quiet)
    tell(flags, written, _lines(document))
    return 0


def _named(output: str) -> Path:
    """File of the document: as it is named, or in a folder that is made."""
    target = Path(output)
    if target.suffix not in {".json", ".html"}:
        target = made_folder(target) / "contrast.json"
    return target.with_suffix(".json")


def _write(written: Any, document: Contrast, target: Path, *, quiet: int) -> None:
    """Write document and page, both or with a message that names what is in the way."""
    from tissueid.report.contrast_page import render_contrast

    page = render_contrast(document, created=time_now())
    write_output(target, json_bytes(written))
    write_output(target.with_suffix(".html"), page.encode("utf-8"))
    note(f"wrote {target} and {target.with_suffix('.html')}", quiet=quiet)


def _tissues(path: Path, interval: str) -> list[tuple[Compared, list[Spread]]]:
    """The tissue of a bundle, or those of a folder with what was measured of them."""
    from tissueid.store.bundle import load_bundle

    if path.is_file():
        if interval == "total":
            refuse(f"{path}: a bundle holds no draws with the machine's calibration; name the output folder")
        return [(_compared(load_bundle(path), None), [])]
    from tissueid.store.results import read_results

    document, _, posteriors = read_results(str(path))
    stored = {one.specimen: one for one in posteriors}
    rows = {one.specimen: list(one.measured or ()) for one in document.specimens}
    return [
        (_compared(load_bundle(path / file), stored.get(name), interval), rows[name])
        for name, file in bundle_names(one.specimen for one in document.specimens).items()
    ]


def _compared(bundle: Bundle, stored: StoredPosterior | None, interval: str = "statistical") -> Compared:
    from tissueid.contrast.decision import Compared

    bundle.require_renderable()
    draws = bundle.draws
    if interval == "total":
        draws = None if stored is None else stored.draws_total
    if draws is None:
        kind = " with the machine's calibration" if interval == "total" else ""
        way_out = ", or --interval statistical" if bundle.draws is not None else ""
        refuse(f"{bundle.specimen}: there are no draws{kind}; fit with a sampler{way_out}")
    model, logs = bundle.contact_model(), len(bundle.provenance.get("inputs", ())) or None
    return Compared(bundle.specimen, model, draws, bundle.speeds_mm_s, total=interval == "total", logs=logs)


def _apart(tissues: list[Compared]) -> list[Compared]:
    """Tissues of one name told apart by a number."""
    often = Counter(tissue.name for tissue in tissues)
    numbers = {name: count(1) for name in often}
    return [
        replace(one, name=f"{one.name} ({next(numbers[one.name])})") if often[one.name] > 1 else one
        for one in tissues
    ]


def _measured_lines(pairs: Sequence[MeasuredPair]) -> Iterator[str]:
    for pair in pairs:
        yield from [*measured_pair_lines(pair), ""]


def _lines(document: Contrast) -> Iterator[str]:
    yield from _measured_lines(document.measured or ())
    common = document.common
    slow, fast = common.speeds_mm_s
    yield f"compared to {common.depth_mm:.3g} mm, {slow:.3g} to {fast:.3g} mm/s"
    yield from (f"! {remark}" for remark in document.remarks)
    for pair in document.pairs:
        verdict = "differ" if pair.difference.different else "not shown to differ"
        yield ""
        yield f"{pair.one} and {pair.other}: {verdict} (p = {pair.difference.probability:.2g})"
        width = max(len(row.name) for row in pair.numbers)
        for row in pair.numbers:
            ratio = "" if row.ratio is None else "ratio {1:.3g} ({0:.3g} to {2:.3g})".format(*row.ratio)
            yield (
                f"  {row.name:<{width}}  {row.one[1]:>9.4g}  {row.other[1]:>9.4g}  {ratio:<32} "
                f"larger: {row.larger:.3f}"
            )
        yield f"  {pair.hand}"


def _is_fit(path: Path) -> bool:
    if path.suffix == ".h5" and not path.is_file():
        refuse(f"{path}: there is no such bundle")
    return (path / "identification.json").is_file() if path.is_dir() else path.suffix == ".h5"


def compare_recordings(flags: _CompareFlags) -> int:
    """Say what recordings showed beside each other, no model: each path is one side."""
    from tissueid.measured.spread import measured_pairs

    if len(flags.paths) < 2:
        refuse("one side is nothing to compare: name a second recording or folder")
    seen: dict[Axes, str] = {}
    sides = [(path, _measured(path, flags, seen)) for path in flags.paths]
    axes, *others = seen
    for other in others:
        refuse(
            f"{seen[other]} is in {other.length} and {other.force}, and {seen[axes]} in {axes.length} and "
            f"{axes.force}: compare recordings of the same --axes"
        )
    written = {
        "schema": "tissueid/measured-contrast/1",
        "tissueid": __version__,
        "pairs": in_units(measured_pairs(sides), axes),
    }
    if flags.output is not None:
        write_output(_named(flags.output), json_bytes(written), quiet=flags.quiet)
    pairs = typed(plain(written), MeasuredContrast).pairs
    tell(flags, written, (line for pair in pairs for line in ("", *measured_pair_lines(pair))))
    return 0


def _measured(path: str, flags: _CompareFlags, seen: dict[Axes, str]) -> Sequence[Spread]:
    """Measured pushes of the recordings of one path; their axes, and a file of each, go into ``seen``."""
    from tissueid.inspection import measured_of, segmented
    from tissueid.measured import spread

    options = segment_options(flags)
    found = []
    for trial in read_all((path,), read_options(flags)):
        divided = segmented(trial, options=options)
        if isinstance(divided, Refusal):
            raise divided.as_error()
        seen.setdefault(trial.axes, trial.source.path)
        found.append(measured_of(trial, divided))
    return spread(found)


def measured_pair_lines(pair: MeasuredPair) -> list[str]:
    """Lines of one pair: the numbers that may be compared, then those that may not, with the reason."""
    lines = [f"{pair.one} and {pair.other}: measured, no model"]
    known = [row for row in pair.numbers if row.reason is None]
    width = max((len(_name(row)) for row in known), default=0)
    for row in known:
        one, other = (with_error(side.mean, side.sd) for side in (row.one, row.other))
        ratio = "" if row.ratio is None else f"ratio {row.ratio:.3g}"
        lines.append(f"  {_name(row):<{width}}  {one:>14}  {other:>14}  {ratio}".rstrip())
    refused = [row for row in pair.numbers if row.reason is not None]
    for reason in dict.fromkeys(row.reason for row in refused):
        names = ", ".join(_name(row) for row in refused if row.reason == reason)
        lines.append(f"  not compared: {names}: {reason}")
    if not pair.numbers:
        lines.append("  nothing is compared: no program, of one speed and depth, is in both")
    return lines


def _name(row: MeasuredNumber) -> str:
    place = "" if row.time_s is None else f" at {row.time_s:g} s"
    place = place if row.depth_mm is None else f" {row.depth_mm:g} {'mm' if row.unit == 'N' else ''}".rstrip()
    unit = "" if row.unit == "1" else f" [{row.unit}]"
    number = f", program {row.program}" if row.program > 1 else ""
    number += f", hold {row.hold}" if row.hold > 1 else ""
    return f"{row.name.replace('_', ' ')}{place}{number}{unit}"
