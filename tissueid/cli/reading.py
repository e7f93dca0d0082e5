"""Options for reading recordings, shared by ``inspect`` and ``fit``, and the loop over their files."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tissueid.cli.completion_command import readers
from tissueid.cli.flags import PATH, Flags, option
from tissueid.cli.output import echo
from tissueid.errors import InputError, refuse
from tissueid.result import Refusal

if TYPE_CHECKING:
    from tissueid.ingest import ReadOptions
    from tissueid.manifest import Study
    from tissueid.segment import SegmentOptions
    from tissueid.study.recordings import FileList, Named
    from tissueid.trial import Trial

#: Names shown where a pattern fits none.
FEW_NAMES = 5
#: No test machine travels ten metres.
LONGEST_TRAVEL_MM = 1e4
#: Flags that say how a file is read.
READING = ("columns", "units", "axes", "specimen_by", "recipe", "sheet", "delimiter", "decimal")
QUANTITIES = ("time", "displacement", "force")
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|"}
DECIMALS = {"point": ".", "comma": ","}


class ReadingFlags(Flags):
    """Flags that say how recordings are read and cut."""

    columns: str | None = option(
        'Which column is what: "time=Zeit,displacement=Weg,force=Kraft".', metavar="MAP"
    )
    units: str | None = option(
        'Units, where the file has none or wrong ones: "displacement=um".', metavar="MAP"
    )
    axes: str | None = option('Normalised channels: "displacement=strain,force=stress".', metavar="MAP")
    specimen_by: str | None = option(
        "Regular expression on the path (path::sheet in a workbook) that names the specimen.",
        metavar="PATTERN",
    )
    recipe: str | None = option(
        "Reader to use, not the detected one; a KEY that is none lists them.",
        metavar="KEY",
        shell_complete=readers,
    )
    sheet: str | None = option(
        "Read only this sheet, block, specimen or member of an archive; FILE::NAME does it for one file.",
        metavar="NAME",
    )
    delimiter: Literal["comma", "semicolon", "tab", "bar"] | None = option(
        "What parts the cells, where the text leaves it open."
    )
    decimal: Literal["point", "comma"] | None = option("Decimal mark, where the numbers leave it open.")
    compression: Literal["positive", "negative"] | None = option(
        "Which direction of displacement is compression, where the guess is wrong."
    )
    contact: float | None = option(
        "Displacement at contact as recorded [mm], where the detected one is wrong.", metavar="MM"
    )
    hold_from: float | None = option(
        "Time at which the hold begins as recorded [s], where the detected one is wrong.", metavar="S"
    )
    hold_to: float | None = option(
        "Time at which the hold ends as recorded [s]; what follows doesn't count.", metavar="S"
    )
    no_rupture: bool = option("No fall of force is a rupture.")
    exclude: tuple[str, ...] = option(
        "Leave out recordings whose path, file, sheet or specimen fits (* and ? allowed).", metavar="PATTERN"
    )


class StudyFlags(ReadingFlags):
    """The same, and the study file whose decisions are followed."""

    study: str | None = option(
        "Study file whose decisions are followed. [default: study.toml of the folder that is named]",
        type=PATH,
        metavar="FILE",
    )
    no_study: bool = option("Leave the folder's study.toml aside.")


def _pairs(text: str | None, flag: str) -> dict[str, str]:
    if not text:
        return {}
    pairs = {}
    for part in text.split(","):
        key, separator, value = part.partition("=")
        if not separator or key.strip() not in QUANTITIES or not value.strip():
            refuse(
                f'{flag} takes pairs like "time=Zeit,force=Kraft" with {", ".join(QUANTITIES)} on the left; '
                f"{part!r} is none"
            )
        pairs[key.strip()] = value.strip()
    return pairs


def read_options(flags: ReadingFlags) -> ReadOptions:
    """Options of reading, from flags."""
    from tissueid.ingest import known_recipe

    if flags.recipe is not None:
        known_recipe(flags.recipe)
    return recorded_options({name: getattr(flags, name) for name in READING})


def recorded_options(said: Mapping[str, str | None]) -> ReadOptions:
    """Options of reading as a run recorded them, by the names of its flags."""
    from tissueid.ingest import ReadOptions

    asked: dict[str, Any] = {key: said.get(key) for key in ("specimen_by", "recipe", "sheet")}
    asked |= {key: _pairs(said.get(key), f"--{key}") for key in ("columns", "units", "axes")}
    delimiter, decimal = (said.get(key) or "" for key in ("delimiter", "decimal"))
    return ReadOptions(**asked, delimiter=DELIMITERS.get(delimiter), decimal=DECIMALS.get(decimal))


def segment_options(flags: ReadingFlags) -> SegmentOptions:
    """Options of segmentation, from flags."""
    from tissueid.segment import SegmentOptions

    contact, start, end = flags.contact, flags.hold_from, flags.hold_to
    if contact is not None and not abs(contact) <= LONGEST_TRAVEL_MM:
        refuse(f"--contact is {contact}; give a displacement in mm as recorded")
    if start is not None and end is not None and not start < end:
        refuse(f"--hold-from {start:g} is not before --hold-to {end:g}: give both in s as recorded")
    return SegmentOptions(
        compression_sign={None: None, "positive": 1, "negative": -1}[flags.compression],
        contact_displacement_mm=contact,
        hold_from_s=start,
        end_s=end,
        rupture=not flags.no_rupture,
        exclude=tuple(flags.exclude),
    )


def refuse_same_folder(paths: tuple[str, ...], out: str) -> None:
    """Refuse an output folder that is an input as well, also through a link."""
    for path in paths:
        folder = Path(path).parent if path.casefold().endswith(".toml") else Path(path)
        if folder.is_dir() and os.path.realpath(folder) == os.path.realpath(out):
            refuse(f"{path} is read and -o {out} is the same folder: name another with -o, as -o results")


def inputs_in_order(paths: tuple[str, ...], study: Study | None = None) -> FileList:
    """Files of all paths with the sheet that was named; a refusal stands where something was refused."""
    from tissueid.ingest.manifest import unmatched_files
    from tissueid.study.recordings import FileList, picked_sheet

    found = FileList([] if study is None else dict.fromkeys(unmatched_files(study)))
    seen: set[tuple[str, str | None] | Refusal] = set()
    for path in paths:
        name, sheet = picked_sheet(path)
        for item in _each_or_refusal(name, sheet):
            # one path names no file twice: nothing of it need be remembered
            if len(paths) > 1:
                key = (str(item[0]), sheet) if isinstance(item, tuple) else item
                if key in seen:
                    continue
                seen.add(key)
            found.add(item)
    return found


def _each_or_refusal(name: str, sheet: str | None) -> Iterator[Named | Refusal]:
    from tissueid.ingest import each_input

    try:
        for file in each_input([name]):
            yield Refusal.of(file) if isinstance(file, InputError) else (file, sheet)
    except InputError as error:
        # a folder without recordings does not stop the others
        yield Refusal.of(error)


def read_in_order(
    paths: tuple[str, ...], options: ReadOptions, study: Study | None = None
) -> Iterator[Trial | Refusal]:
    """Trials of all paths, one at a time, as a study decides; refusals stand where something was refused."""
    from tissueid.study.recordings import read_decided

    by_pattern = PatternCheck(options.specimen_by, study)
    for one in inputs_in_order(paths, study):
        if isinstance(one, Refusal):
            yield one
            continue
        path, sheet = one
        for item in read_decided(path, options if sheet is None else replace(options, sheet=sheet), study):
            if isinstance(item, InputError):
                yield Refusal.of(item)
            else:
                by_pattern.add(item.source.path, item.source.sheet)
                yield item
    by_pattern.say()


class PatternCheck:
    """Check that ``--specimen-by`` named specimens of its own; those that a study names are not."""

    def __init__(self, pattern: str | None, study: Study | None) -> None:
        from tissueid.study.recordings import StudyParts

        self._pattern, self._study = pattern, study
        self._parts = None if pattern is None or study is None else StudyParts(study)
        self._stated = self._named = 0
        self._missed: list[str] = []

    def add(self, path: str, sheet: str | None) -> None:
        """Count one recording."""
        if self._pattern is None:
            return
        # the part of a study that speaks of this file: asking all of it each time would be quadratic
        if self._parts is not None and "specimen" in self._parts.of_file(path).decision(path, sheet).trial:
            self._stated += 1
            return
        name = path if sheet is None else f"{path}::{sheet}"
        if re.search(self._pattern, name):
            self._named += 1
        elif len(self._missed) <= FEW_NAMES:
            self._missed.append(name)

    def say(self) -> None:
        """Refuse a pattern that fits nothing; name what it leaves by itself, and readers that are broken."""
        from tissueid.ingest import reader_faults

        if self._study is not None and self._stated:
            count = "1 recording" if self._stated == 1 else f"{self._stated} recordings"
            message = f"{self._study.path} names the specimen of {count}: --specimen-by does not apply there"
            echo(f"note: {message}", fg="yellow", err=True)
        warnings = []
        if self._missed:
            shown = ", ".join(self._missed[:FEW_NAMES]) + (" ..." if len(self._missed) > FEW_NAMES else "")
            if self._named == 0 and not self._stated:
                refuse(f"--specimen-by {self._pattern!r} fits no recording: it was tried on {shown}")
            warnings.append(f"--specimen-by {self._pattern!r} does not fit {shown}: each is its own specimen")
        for warning in (*warnings, *reader_faults()):
            echo(f"warning: {warning}", fg="yellow", err=True)


def read_all(
    paths: tuple[str, ...],
    options: ReadOptions,
    study: Study | None = None,
    refused: list[Refusal] | None = None,
) -> Iterator[Trial]:
    """The trials of all paths; refusals go to ``refused``, the first is raised where nothing takes them."""
    for item in read_in_order(paths, options, study):
        if not isinstance(item, Refusal):
            yield item
        elif refused is None:
            raise item.as_error()
        else:
            refused.append(item)
