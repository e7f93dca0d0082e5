"""The common case: all recordings are of one specimen, which is fitted while they are read.

Whether there is one specimen is known when the last file was read, and by then its recordings are segmented
already: nothing is read twice.  A second specimen ends the attempt; what was read stays known.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from tissueid.collection import display_names
from tissueid.errors import InputError
from tissueid.pipeline import identify
from tissueid.result import Identification
from tissueid.study.inventory import Inventory
from tissueid.study.recordings import read_decided, read_decided_one
from tissueid.study.request import Progress
from tissueid.study.specimen_job import RecentTrials, chain_file
from tissueid.study.survey import found_in, recording_rows
from tissueid.trial import Source, Trial


class SeveralSpecimensError(Exception):
    """The recordings are of more than one specimen."""


def fit_while_read(
    inventory: Inventory, chains: Path, recent: RecentTrials, progress: Progress
) -> Identification:
    """Read every file of a request and fit its one specimen.

    ``inventory``: told of every file; ``chains``: folder for chains that are being sampled; ``recent``: told
    of every trial, for the jobs where there are several specimens.  Raises SeveralSpecimensError: there is
    more than one.
    """
    request = inventory.request
    names: dict[str, str] = {}
    return identify(
        _trials(inventory, names, recent),
        study=request.study,
        options=request.options,
        reload=lambda source: read_decided_one(source.path, source.sheet, request.reading, request.study),
        provenance=request.provenance,
        progress=progress,
        checkpoint=lambda name: chain_file(chains, name),
        names=names,
    )


def _trials(inventory: Inventory, names: dict[str, str], recent: RecentTrials) -> Iterator[Trial]:
    """Trials of one specimen as they are read; its name as shown goes into ``names``."""
    for position in range(len(inventory.request.found)):
        file = inventory.file(position)
        if file is None:
            continue
        found = []
        for item in read_decided(Path(file.path), file.options, file.study):
            found.append(found_in(item))
            if isinstance(item, InputError):
                continue
            recent.keep(item)
            (row,) = recording_rows(file.path, found[-1:], inventory.parts)
            if row.kind in {"trial", "excluded"} and row.specimen not in names:
                if names:
                    raise SeveralSpecimensError
                source = Source(path=row.path, sheet=row.sheet)
                names.update(display_names([(row.specimen, source)]))
            yield item
        inventory.put_down(position, found)
    inventory.request.all_read()
    recent.clear()
