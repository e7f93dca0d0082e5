"""Options for reading recordings, shared by ``inspect`` and ``fit``, and the loop over their files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import click

from tissueid.errors import UsageError

if TYPE_CHECKING:
    from pathlib import Path

    from tissueid.errors import InputError
    from tissueid.ingest import ReadOptions
    from tissueid.manifest import Study
    from tissueid.result import Refusal
    from tissueid.segment import SegmentOptions
    from tissueid.trial import Trial

__all__ = ["read_all", "read_in_order", "read_options", "reading_options", "segment_options"]

#: No test machine travels ten metres.
LONGEST_TRAVEL_MM = 1e4
QUANTITIES = ("time", "displacement", "force")


def reading_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the reading options to a sub-command."""
    options = (
        click.option(
            "--columns",
            metavar="MAP",
            help='Which column is what: "time=Zeit,displacement=Weg,force=Kraft".',
        ),
        click.option(
            "--units",
            metavar="MAP",
            help='Units, where the file has none or wrong ones: "displacement=um".',
        ),
        click.option(
            "--axes",
            metavar="MAP",
            help='Normalised channels: "displacement=strain,force=stress".',
        ),
        click.option(
            "--specimen-by",
            metavar="PATTERN",
            help="Regular expression on the path (path::sheet in a workbook) that names the specimen.",
        ),
        click.option("--recipe", metavar="KEY", help="Reader to use instead of the detected one."),
        click.option(
            "--compression",
            type=click.Choice(["positive", "negative"]),
            help="Which direction of displacement is compression, where the guess is wrong.",
        ),
        click.option(
            "--contact",
            type=float,
            metavar="MM",
            help="Displacement at contact as recorded [mm], where the detected one is wrong.",
        ),
    )
    for option in reversed(options):
        function = option(function)
    return function


def _pairs(text: str | None, flag: str) -> dict[str, str]:
    if not text:
        return {}
    pairs = {}
    for part in text.split(","):
        key, separator, value = part.partition("=")
        if not separator or key.strip() not in QUANTITIES or not value.strip():
            msg = (
                f'{flag} takes pairs like "time=Zeit,force=Kraft" with {", ".join(QUANTITIES)} on the left; '
                f"{part!r} is none"
            )
            raise UsageError(msg)
        pairs[key.strip()] = value.strip()
    return pairs


def read_options(
    *, columns: str | None, units: str | None, axes: str | None, specimen_by: str | None, recipe: str | None
) -> ReadOptions:
    """Reading options from flags."""
    from tissueid.ingest import ReadOptions

    return ReadOptions(
        columns=_pairs(columns, "--columns"),
        units=_pairs(units, "--units"),
        axes=_pairs(axes, "--axes"),
        specimen_by=specimen_by,
        recipe=recipe,
    )


def segment_options(*, compression: str | None, contact: float | None) -> SegmentOptions:
    """Segmentation options from flags."""
    from tissueid.segment import SegmentOptions

    if contact is not None and not abs(contact) <= LONGEST_TRAVEL_MM:
        msg = f"--contact is {contact}; give a displacement in mm as recorded"
        raise UsageError(msg)
    sign = {None: None, "positive": 1, "negative": -1}[compression]
    return SegmentOptions(compression_sign=sign, contact_displacement_mm=contact)


def _refusal(error: InputError) -> Refusal:
    from tissueid.result import Refusal

    return Refusal(
        path=error.path,
        sheet=error.sheet,
        code=error.code,
        message=error.message,
        line=error.line,
        column=error.column,
    )


def read_in_order(
    paths: tuple[str, ...], options: ReadOptions, study: Study | None = None
) -> Iterator[Trial | Refusal]:
    """Trials of all paths, one at a time; a refusal stands in the place of what was refused.

    With a study, columns and units are those it decides, and what it names in vain is refused first.

    Raises
    ------
    UsageError
        At once, where a path does not exist.
    """
    from tissueid.errors import InputError
    from tissueid.ingest import find_inputs
    from tissueid.ingest.manifest import unmatched_files

    found: dict[Path | Refusal, None] = {} if study is None else dict.fromkeys(unmatched_files(study))
    for path in paths:
        try:
            found.update(dict.fromkeys(find_inputs([path])))
        except InputError as error:
            # a folder without recordings does not stop the others
            found[_refusal(error)] = None
    return _read(list(found), options, study)


def _read(
    found: list[Path | Refusal], options: ReadOptions, study: Study | None
) -> Iterator[Trial | Refusal]:
    from tissueid.errors import InputError
    from tissueid.result import Refusal
    from tissueid.study.recordings import read_decided

    for one in found:
        if isinstance(one, Refusal):
            yield one
            continue
        for item in read_decided(one, options, study):
            yield _refusal(item) if isinstance(item, InputError) else item


def read_all(items: Iterator[Trial | Refusal], refused: list[Refusal]) -> Iterator[Trial]:
    """The trials among some items; refusals go to ``refused``."""
    from tissueid.result import Refusal

    for item in items:
        if isinstance(item, Refusal):
            refused.append(item)
        else:
            yield item
