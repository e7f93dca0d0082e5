"""Recipe for Optics11 Chiaro text: tabs, mixed line ends, a micro sign of cp1252.

::

    Date<tab>12/05/2025<tab>Time<tab>11:20:38<tab>Status<tab>OK
    Tip radius (um)<tab>27.500
    Piezo speed  (µm/s)<tab>7.000

    Time (s)<tab>Load (uN)<tab>Indentation (nm)<tab>Cantilever (nm)<tab>Piezo (nm)<tab>Auxiliary
    0.000000<tab>-0.000308<tab>0.000000<tab>-16.214418<tab>64.971622<tab>-0.002890

``Indentation`` is the depth of the tip: the piezo's way less the bending of the cantilever.
"""

from __future__ import annotations

from tissueid.ingest.columns import split_name
from tissueid.ingest.delimited import read_delimited
from tissueid.ingest.recipe import Detection, InputFile, Recipe
from tissueid.ingest.vocabulary import plain_words

__all__ = ["CHIARO"]

_COLUMNS = frozenset({"time", "load", "indentation", "cantilever", "piezo"})


def detect_chiaro(file: InputFile) -> Detection:
    """The columns of a cantilever indenter."""
    if file.layout is None:
        return 0.0, "no table of numbers"
    names = {plain_words(split_name(name)[0]) for name in file.layout.names}
    if names >= _COLUMNS:
        return 0.98, "the columns are those of a cantilever on a piezo: Load, Indentation, Cantilever, Piezo"
    return 0.0, "no columns of cantilever and piezo"


CHIARO = Recipe("chiaro", "Optics11 Chiaro text (nano-indenter)", detect_chiaro, read_delimited)
