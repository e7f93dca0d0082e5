"""Recordings as they are inspected, one after the other, and what a page of them needs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissueid.decided import as_decided
from tissueid.documents import plain, typed
from tissueid.documents.inspect import Trial as InspectedTrial
from tissueid.documents.measured import MeasuredPush
from tissueid.errors import refuse
from tissueid.ingest.manifest import MANIFEST
from tissueid.inspection import describe_segmented, measured_of, segmented
from tissueid.manifest import Study
from tissueid.result import Refusal
from tissueid.segment import SegmentOptions
from tissueid.store.files import time_now
from tissueid.trial import Trial

if TYPE_CHECKING:
    # pages load a compiler, which a line a recording doesn't need
    from tissueid.report.inspect_page import InspectedRecording


def study_folder(paths: Sequence[str]) -> Path:
    """Folder of study.toml, there or not: beside or above what was named."""
    folders = [path if path.is_dir() else path.parent for path in (Path(name).resolve() for name in paths)]
    one_drive = len({folder.drive for folder in folders}) == 1
    common = Path(os.path.commonpath(folders)) if one_drive else folders[0]
    above = [folder for folder in (common, *common.parents) if (folder / MANIFEST).is_file()]
    return above[0] if above else common


def relative_name(path: str, root: Path) -> str:
    """A path as study.toml names it: from its folder, with forward slashes."""
    whole = Path(path).resolve()
    return (whole.relative_to(root) if whole.is_relative_to(root) else whole).as_posix()


def reader_words(document: InspectedTrial) -> str:
    """Words on the reader of a recording, and the reason."""
    marks = (
        (document.encoding, "{}"),
        (document.delimiter, "delimiter {!r}"),
        (document.decimal, "decimal mark {!r}"),
    )
    text = [
        f"Read as {document.recipe} (sure to {document.recipe_confidence:.0%})",
        *(form.format(mark) for mark, form in marks if mark),
    ]
    why = document.recipe_reason
    return ", ".join(text) + (f", because {why}" if why else "")


@dataclass(frozen=True, slots=True)
class _Made:
    """One recording, described."""

    document: InspectedTrial
    plain: dict[str, Any]  # the same, as it is printed
    drawn: InspectedRecording | None


class Inspection:
    """Inspection of recordings, in their order; each is let go as soon as it is described.

    ``drawn``: keep the curves, thinned, for a page.
    """

    def __init__(self, options: SegmentOptions, study: Study | None, root: Path, *, drawn: bool) -> None:
        self.study = study
        self.described: list[InspectedTrial | Refusal] = []
        self.printed: list[dict[str, Any]] = []  # the same, for --json
        self.shown: list[InspectedRecording] = []
        self._options, self._root, self._drawn = options, root, drawn
        self._earlier: dict[str, list[MeasuredPush]] = {}

    @property
    def read(self) -> list[InspectedTrial]:
        """Recordings that could be described."""
        return [one for one in self.described if not isinstance(one, Refusal)]

    @property
    def refused(self) -> list[Refusal]:
        """Those that could not."""
        return [one for one in self.described if isinstance(one, Refusal)]

    def add(self, item: Trial | Refusal) -> None:
        """Describe one more recording."""
        made = item if isinstance(item, Refusal) else self._made(item, self.study)
        if isinstance(made, Refusal):
            self.described.append(made)
            self.printed.append(made.as_json())
            return
        self.described.append(made.document)
        self.printed.append(made.plain)
        push = made.document.measured.push
        if made.document.excluded is None and push is not None:
            self._earlier.setdefault(made.document.specimen, []).append(push)
        if made.drawn is not None:
            self.shown.append(made.drawn)

    def remade(self, trial: Trial, study: Study) -> InspectedRecording:
        """A recording described anew, as another study has it; UsageError where it can't be segmented so."""
        made = self._made(trial, study)
        if isinstance(made, Refusal) or made.drawn is None:
            refuse(str(made) if isinstance(made, Refusal) else "this inspection draws nothing")
        return made.drawn

    def place(self, path: str, sheet: str | None) -> int | None:
        """Position of a recording among those that are shown."""
        documents = [one.document for one in self.shown]
        return next((i for i, one in enumerate(documents) if (one.path, one.sheet) == (path, sheet)), None)

    def page(self, *, served: bool = False) -> str:
        """All of it as a page."""
        from tissueid.report.inspect_page import render_inspection

        study = (
            MANIFEST
            if (self._root / MANIFEST).is_file()
            else f"{MANIFEST} in {self._root.name or self._root}"
        )
        return render_inspection(self.shown, self.refused, study=study, created=time_now(), served=served)

    def _made(self, trial: Trial, study: Study | None) -> _Made | Refusal:
        trial, options, excluded = as_decided(trial, self._options, study)
        divided = segmented(trial, options=options)
        if isinstance(divided, Refusal):
            return divided
        measured = measured_of(trial, divided, study)
        earlier = self._earlier.get(trial.specimen, [])
        described = describe_segmented(trial, divided, excluded=excluded, measured=measured, earlier=earlier)
        printed = plain(described)
        document = typed(printed, InspectedTrial)
        if not self._drawn:
            return _Made(document, printed, None)
        from tissueid.report.inspect_decisions import decisions
        from tissueid.report.inspect_page import InspectedRecording, drawn_recording
        from tissueid.study.corrections import standing

        drawn, path = drawn_recording(trial, divided), trial.source.path
        said = decisions(document, file=relative_name(path, self._root))
        stands = standing(study, path, trial.source.sheet)
        shown = InspectedRecording(document, drawn, said, reader_words(document), stands)
        return _Made(document, printed, shown)
