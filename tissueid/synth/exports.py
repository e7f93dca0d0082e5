"""Every export that can be written: Bluehill in its dialects, and the formats of other machines.

Written from the grammar of each format, with no part of the reader; every file says that it is synthetic.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

from tissueid.synth.bluehill import bluehill_csv
from tissueid.synth.dialects import DIALECTS
from tissueid.synth.machines import (
    chiaro_text,
    chiaro_zip,
    mach1_text,
    mts793_text,
    shimadzu_text,
    tra_text,
)
from tissueid.synth.simulate import SyntheticLog
from tissueid.synth.workbooks import bluehill_workbook, zwick_workbook

Decimals = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Export:
    """A way to write a log."""

    description: str  # one line for the help
    suffix: str  # of the file, with its point
    write: Callable[..., bytes]  # ``write(log, decimals=...) -> bytes``


def _one(write: Callable[..., bytes], **how: object) -> Callable[..., bytes]:
    """A writer of several logs, given one."""

    def written(log: SyntheticLog, *, decimals: Decimals = (5, 5, 5)) -> bytes:
        return write([log], decimals=decimals, **how)

    return written


#: Exports by name.
EXPORTS: Mapping[str, Export] = MappingProxyType(
    {
        **{
            name: Export(f"Bluehill: {dialect.description}", ".csv", partial(bluehill_csv, dialect=dialect))
            for name, dialect in DIALECTS.items()
        },
        "bluehill-workbook": Export(
            "Bluehill's table as .xlsx, with half-cycle counters", ".xlsx", _one(bluehill_workbook)
        ),
        "testxpert-tra": Export("testXpert .TRA, English", ".TRA", partial(tra_text, language="en")),
        "testxpert-tra-fr": Export("testXpert .TRA, French", ".TRA", partial(tra_text, language="fr")),
        "testxpert-tra-de": Export(
            "testXpert .TRA, German, semicolons and decimal commas",
            ".TRA",
            partial(tra_text, language="de", delimiter=";", decimal=","),
        ),
        "testxpert-workbook": Export(
            "testXpert .xlsx, English", ".xlsx", _one(zwick_workbook, language="en")
        ),
        "testxpert-workbook-fr": Export(
            "testXpert .xlsx, French", ".xlsx", _one(zwick_workbook, language="fr")
        ),
        "testxpert-workbook-de": Export(
            "testXpert .xlsx, German", ".xlsx", _one(zwick_workbook, language="de")
        ),
        "mach-1": Export("Mach-1 text: a contact block, then the log, in gf", ".txt", _one(mach1_text)),
        "mts-793": Export("MTS 793 text, English", ".dat", _one(mts793_text, language="en")),
        "mts-793-de": Export(
            "MTS 793 text, German, decimal commas, kN", ".dat", _one(mts793_text, language="de")
        ),
        "shimadzu": Export("Shimadzu text: three head rows", ".csv", _one(shimadzu_text)),
        "chiaro": Export("Optics11 Chiaro text, in uN and nm", ".txt", chiaro_text),
        "chiaro-zip": Export("Optics11 Chiaro text in a zip archive", ".zip", chiaro_zip),
    }
)
