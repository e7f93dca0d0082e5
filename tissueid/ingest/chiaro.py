"""Recipe for Optics11 Piuma and Chiaro text: tabs, mixed line ends, a micro sign of cp1252.

::

    Date<tab>12/05/2025<tab>Time<tab>11:20:38<tab>Status<tab>OK
    Tip radius (um)<tab>27.500
    k (N/m)<tab>0.500
    Piezo speed  (µm/s)<tab>7.000
    D[Z1] (nm)<tab>10000.000<tab>t[1] (s)<tab>2.000
    D[Z2] (nm)<tab>10000.000<tab>t[2] (s)<tab>30.000

    Time (s)<tab>Load (uN)<tab>Indentation (nm)<tab>Cantilever (nm)<tab>Piezo (nm)<tab>Auxiliary
    0.000000<tab>-0.000308<tab>0.000000<tab>-16.214418<tab>64.971622<tab>-0.002890

``Indentation`` is the depth of the tip: the piezo's way less the bending of the cantilever.  A sweep gives
where the piezo goes and in which time: a step to the same place is a hold.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace

from tissueid.errors import InputError
from tissueid.ingest.columns import split_name
from tissueid.ingest.delimited import read_delimited
from tissueid.ingest.header import protocol_of
from tissueid.ingest.recipe import Detection, InputFile, Recipe, Table
from tissueid.ingest.vocabulary import plain_words

_STEP = re.compile(r"([-+\d.,]+) t\[\d\] \(s\) ([-+\d.,]+)")
_NM_TO_MM = 1e-6
_COLUMNS = frozenset({"time", "load", "indentation", "cantilever", "piezo"})


def detect_chiaro(file: InputFile) -> Detection:
    """The columns of a cantilever indenter."""
    if file.layout is None:
        return 0.0, "no table of numbers"
    names = {plain_words(split_name(name)[0]) for name in file.layout.names}
    if names >= _COLUMNS:
        return 0.98, "the columns are those of a cantilever on a piezo: Load, Indentation, Cantilever, Piezo"
    return 0.0, "no columns of cantilever and piezo"


def read_chiaro(file: InputFile) -> Iterator[Table | InputError]:
    """The one table, with the tip and the sweep of the header as its protocol."""
    for item in read_delimited(file):
        if isinstance(item, InputError):
            yield item
            continue
        stated = protocol_of(item.metadata, file.path, decimal=item.decimal)
        steps = _sweep(item.metadata)
        if stated.speed_mm_s is None and steps and steps[0][0] != 0.0:
            stated = replace(stated, speed_mm_s=abs(steps[0][0]) / steps[0][1])
        if stated.hold_s is None and len(steps) > 1 and steps[1][0] == steps[0][0]:
            stated = replace(stated, hold_s=steps[1][1])
        yield replace(item, protocol=stated)


def _sweep(metadata: Mapping[str, str]) -> list[tuple[float, float]]:
    """The steps of the piezo up to the first that is not used: where to [mm], and in which time [s]."""
    steps: list[tuple[float, float]] = []
    for number in range(1, 10):
        match = _STEP.fullmatch(metadata.get(f"D[Z{number}] (nm)", ""))
        try:
            place, seconds = (
                (float(text.replace(",", ".")) for text in match.groups()) if match else (0.0, 0.0)
            )
        except ValueError:
            break
        if seconds <= 0.0:
            break
        steps.append((place * _NM_TO_MM, seconds))
    return steps


CHIARO = Recipe("chiaro", "Optics11 Piuma and Chiaro text (nano-indenter)", detect_chiaro, read_chiaro)
