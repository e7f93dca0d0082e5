"""``tissueid compare``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.flags import OutputFlags, argument, option, takes
from tissueid.cli.output import echo, echo_json, note, progress_bar, write_output
from tissueid.cli.reading import ReadingFlags
from tissueid.documents import typed
from tissueid.documents.contrast import Contrast, MeasuredPair
from tissueid.errors import UsageError

if TYPE_CHECKING:
    from tissueid.contrast.document import Compared
    from tissueid.documents.measured import Spread
    from tissueid.store.bundle import Bundle
    from tissueid.store.posteriors import StoredPosterior

EPILOG = """\b
Examples:
  tissueid compare out/bundle-kidney.h5 out/bundle-liver.h5
  tissueid compare before/ after/ --interval total
  tissueid compare out -o compared
  tissueid compare slow.csv fast.csv
"""
#: Clamp of the simulated device and of a calibrated one at its default [N].
CLAMP_N = 5.0


@dataclass(frozen=True, kw_only=True)
class CompareFlags(ReadingFlags, OutputFlags):
    """Flags of ``tissueid compare``."""

    # fmt: off
    paths: tuple[str, ...] = argument(nargs=-1, required=True, type=click.Path())
    interval: str = option(
        "--interval", type=click.Choice(["statistical", "total"]), default="statistical", show_default=True,
        help="total for recordings of different machines: it knows their calibration. Needs output folders.",
    )
    clamp: float = option(
        "--clamp", type=click.FloatRange(min=0.0, min_open=True), default=CLAMP_N, show_default=True,
        metavar="N", help="Largest force of the device at which a hand would feel them.",
    )
    output: str | None = option(
        "-o", "--output", type=click.Path(), metavar="PATH",
        help="Folder for contrast.json and contrast.html; or NAME.json, and NAME.html is written beside it.",
    )
    # fmt: on


@click.command("compare", epilog=EPILOG)
@takes(CompareFlags)
def command(flags: CompareFlags) -> int:
    """Say whether identified tissues differ, by how much, and whether a hand could feel it.

    PATHS are bundles, or output folders of which every specimen is taken. Forces at depths and speeds that
    all were identified at are tested together, pair by pair; numbers stand beside each other with the
    probability that one is larger, and of output folders what was measured, no model. Two recordings of one
    machine share its calibration, two machines do not.

    PATHS may be recordings or folders of them instead, each one side: what was measured stands beside each
    other, no model. A number that depends on the ramp is compared within one program only.
    """
    from tissueid.cli.compare_measured import are_recordings, compare_recordings

    if are_recordings(flags.paths):
        return compare_recordings(flags)
    from tissueid.contrast.document import contrast_document
    from tissueid.measured.comparison import measured_pairs
    from tissueid.store.files import plain_json
    from tissueid.store.schema import check

    both = [tissue for path in flags.paths for tissue in _tissues(Path(path), flags.interval)]
    if len(both) < 2:
        msg = "one tissue is nothing to compare: name a second bundle or output folder"
        raise UsageError(msg)
    tissues = _apart([tissue for tissue, _ in both])
    measured = measured_pairs(
        [(tissue.name, rows) for tissue, (_, rows) in zip(tissues, both, strict=True) if rows]
    )
    try:
        with progress_bar(show=not flags.quiet) as progress:
            found = contrast_document(tissues, clamp_N=flags.clamp, progress=progress)
    except UsageError:
        # models that share no speed can't be compared; what was measured at any time may
        if not flags.as_json and not flags.quiet:
            _print_measured(typed(plain_json(measured), tuple[MeasuredPair, ...]))
        raise
    plain = plain_json(found) | ({"measured": plain_json(measured)} if measured else {})
    check(plain, "contrast", where="contrast.json")
    document = typed(plain, Contrast)
    if flags.output is not None:
        _write(plain, Path(flags.output), quiet=flags.quiet)
    if flags.as_json:
        echo_json(plain)
    elif not flags.quiet:
        _print(document)
    return 0


def _write(plain: Any, target: Path, *, quiet: int) -> None:
    """Write document and page, both or with a message that names what is in the way."""
    from datetime import UTC, datetime

    from tissueid.report.contrast_page import render_contrast
    from tissueid.store.files import json_bytes

    if target.suffix not in {".json", ".html"}:
        try:
            target.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            msg = f"{target}: can't be made ({error.strerror}); choose another place with -o"
            raise UsageError(msg) from error
        target = target / "contrast.html"
    page = render_contrast(typed(plain, Contrast), created=datetime.now(UTC).isoformat(timespec="seconds"))
    write_output(str(target.with_suffix(".json")), json_bytes(plain))
    write_output(str(target.with_suffix(".html")), page.encode("utf-8"))
    note(f"wrote {target.with_suffix('.json')} and {target.with_suffix('.html')}", quiet=quiet)


def _tissues(path: Path, interval: str) -> list[tuple[Compared, list[Spread]]]:
    """The tissue of a bundle, or those of a folder with what was measured of them."""
    from tissueid.store.bundle import load_bundle

    if path.is_file():
        if interval == "total":
            msg = f"{path}: a bundle holds no draws with the machine's calibration; name the output folder"
            raise UsageError(msg)
        return [(_compared(load_bundle(path), None), [])]
    from tissueid.store.files import bundle_names
    from tissueid.store.results import read_results

    document, _, posteriors = read_results(str(path))
    stored = {one.specimen: one for one in posteriors}
    rows = {one.specimen: list(one.measured or ()) for one in document.specimens}
    names = bundle_names(one.specimen for one in document.specimens)
    return [
        (
            _compared(load_bundle(path / file), stored.get(name) if interval == "total" else None, interval),
            rows[name],
        )
        for name, file in names.items()
    ]


def _compared(bundle: Bundle, stored: StoredPosterior | None, interval: str = "statistical") -> Compared:
    from tissueid.contrast.document import Compared

    bundle.require_renderable()
    model = bundle.contact_model()
    draws = bundle.draws
    if interval == "total":
        draws = None if stored is None else stored.draws_total
    if draws is None:
        kind = " with the machine's calibration" if interval == "total" else ""
        msg = f"{bundle.specimen}: there are no draws{kind}; fit with a sampler, or --interval statistical"
        raise UsageError(msg)
    return Compared(bundle.specimen, model, draws, bundle.speeds_mm_s, total=interval == "total")


def _apart(tissues: list[Compared]) -> list[Compared]:
    """Tissues of one name told apart by a number."""
    from collections import Counter
    from dataclasses import replace

    often = Counter(tissue.name for tissue in tissues)
    seen: Counter[str] = Counter()
    named = []
    for tissue in tissues:
        seen[tissue.name] += 1
        again = often[tissue.name] > 1
        named.append(replace(tissue, name=f"{tissue.name} ({seen[tissue.name]})") if again else tissue)
    return named


def _print_measured(pairs: Sequence[MeasuredPair]) -> None:
    from tissueid.cli.compare_measured import measured_pair_lines

    for pair in pairs:
        for line in measured_pair_lines(pair):
            echo(line)
        echo()


def _print(document: Contrast) -> None:
    _print_measured(document.measured or ())
    common = document.common
    slow, fast = common.speeds_mm_s
    echo(f"compared to {common.depth_mm:.3g} mm, {slow:.3g} to {fast:.3g} mm/s")
    for pair in document.pairs:
        verdict = "differ" if pair.difference.different else "not shown to differ"
        probability = pair.difference.probability
        echo()
        echo(f"{pair.one} and {pair.other}: {verdict} (p = {probability:.2g})")
        width = max(len(row.name) for row in pair.numbers)
        for row in pair.numbers:
            ratio = "" if row.ratio is None else "ratio {1:.3g} ({0:.3g} to {2:.3g})".format(*row.ratio)
            echo(
                f"  {row.name:<{width}}  {row.one[1]:>9.4g}  {row.other[1]:>9.4g}  {ratio:<32} "
                f"larger: {row.larger:.3f}"
            )
        felt = [one for one in pair.noticed if one.times > 1.0]
        if felt:
            most = max(felt, key=lambda one: one.times)
            limit = most.limit
            times = f"{most.times:.2g} times the just-noticeable difference"
            source = f"{limit.source}, doi {limit.doi}: {limit.conditions}"
            echo(f"  a hand could tell: {most.name}, {times} ({source})")
        else:
            echo("  a hand would hardly tell: no difference exceeds a published just-noticeable one")
