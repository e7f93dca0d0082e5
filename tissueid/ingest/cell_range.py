"""The force against the range in which the load cell was verified.

A load cell is calibrated in a range (ISO 7500-1, ASTM E4), which ends well above zero: below it the force is
a number without a class.  The lower end stands in the calibration certificate, the capacity often in the
header of the export.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.ingest.header import stated

#: Share of its capacity from which a load cell is taken as verified where nobody says: certificates reach
#: down to 1/100, some to 1/250 or 1/1000.
UNSTATED_RANGE = 0.01

_CELL = r"(?:load cell|force (?:transducer|sensor|cell)|kraft(?:aufnehmer|sensor|messdose)|capteur de force"
_CELL += r"|cellule de charge|celula de carga|cella di carico|czujnik sily|力传感器|载荷传感器)"
_SIZE = r"(?:capacity|rated capacity|rating|range|full scale|nominal (?:force|load)|maximum (?:force|load)"
_SIZE += r"|nennkraft|nennlast|messbereich|capacite|etendue|capacidad|capacita|zakres|量程|容量)"
_CAPACITY = re.compile(
    rf"(?:{_CELL} )?(?:{_CELL} {_SIZE}|{_SIZE} (?:of |de |du |der |della )?{_CELL})|{_CELL}"
)


def capacity_in(metadata: Mapping[str, str], *, decimal: str | None) -> float | None:
    """Capacity of the load cell [N], where the header states it with a unit.

    ``metadata``: entries of the header; ``decimal``: decimal mark of the file.
    """
    return stated(metadata, _CAPACITY, "force", decimal or ".")


def below_cell_range(
    force_N: FloatArray, capacity_N: float | None, *, verified_from_N: float | None = None
) -> Flag | None:
    """``below_cell_range``, where the largest force is below the verified range.

    ``force_N`` (n,): as recorded; ``capacity_N``: capacity of the load cell [N]; ``verified_from_N``: lower
    end of the verified range [N]; else :data:`UNSTATED_RANGE` of the capacity.
    """
    if verified_from_N is None and capacity_N is None:
        return None
    lowest = UNSTATED_RANGE * (capacity_N or 0.0) if verified_from_N is None else verified_from_N
    # the zero of a load cell is arbitrary: what counts is how far the force goes from where it began
    largest = float(np.abs(force_N - force_N[0]).max())
    if not 0.0 < largest < lowest:
        return None
    source = "as stated" if verified_from_N is not None else f"1 % of the {capacity_N:.4g} N cell"
    values = {"largest_N": largest, "verified_from_N": lowest}
    if capacity_N is not None:
        values["capacity_N"] = capacity_N
    return Flag(
        "below_cell_range",
        f"force changes by {largest:.3g} N, below the verified {lowest:.3g} N ({source})",
        values,
    )
