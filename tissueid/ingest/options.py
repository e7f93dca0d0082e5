"""Options by which the user tells the readers, where a file does not speak for itself."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import cast

from tissueid.errors import UsageError
from tissueid.ingest.vocabulary import CHANNELS, Channel
from tissueid.trial import Axes
from tissueid.units import Quantity, factor_to

#: What a channel may be declared to hold, the usual first.
AXES: Mapping[str, tuple[str, ...]] = {
    "displacement": ("displacement", "strain"),
    "force": ("force", "stress"),
}


@dataclass(frozen=True)
class ReadOptions:
    """Corrections to what a reader would decide by itself.

    Attributes
    ----------
    columns : mapping
        ``{"time" | "displacement" | "force": name}``: the column as printed, with or without its unit,
        or ``"#2"`` for the second column of a file without names.
    units : mapping
        ``{"time" | "displacement" | "force": unit}``, in place of what the file says.
    axes : mapping
        ``{"displacement": "strain"}`` (or stretch: a length over a length), ``{"force": "stress"}``: the
        channel is normalised; units are then those of a strain or stress, and results carry them.
    specimen_by : str or None
        Regular expression searched in ``"path"`` or ``"path::sheet"``; its first group, or the whole
        match, names the specimen.  Wins over the file's header.
    recipe : str or None
        Key of the reader to use.
    sheet : str or None
        Read only this sheet, block, specimen or member of an archive: its name, or the number before it.
    delimiter, decimal : str or None
        One character each, for text that leaves them open.

    Raises
    ------
    UsageError
        Unknown channel, unit, delimiter or decimal mark, or a pattern that does not compile.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    axes: Mapping[str, str] = field(default_factory=dict)
    specimen_by: str | None = None
    recipe: str | None = None
    sheet: str | None = None
    delimiter: str | None = None
    decimal: str | None = None

    def __post_init__(self) -> None:
        for name in ("columns", "units", "axes"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        for msg in self._faults():
            raise UsageError(msg)

    def _faults(self) -> Iterator[str]:
        """Faults of the options, in one sentence each."""
        for name in ("columns", "units", "axes"):
            for channel in getattr(self, name):
                if channel not in CHANNELS:
                    yield f"{name}: unknown channel {channel!r}, one of {', '.join(CHANNELS)}"
        for channel, axis in self.axes.items():
            if axis not in AXES.get(channel, ()):
                yield f"axes: {channel} can't be {axis!r}; displacement=strain and force=stress are possible"
        for channel, unit in self.units.items():
            try:
                factor_to(unit, self.quantity(cast("Channel", channel)))
            except ValueError as error:
                yield f"units: {error}"
        if self.specimen_by is not None:
            try:
                re.compile(self.specimen_by)
            except re.error as error:
                yield f"specimen_by: {self.specimen_by!r} is not a regular expression: {error}"
        if self.delimiter not in {None, ",", ";", "\t", "|"}:
            yield f"delimiter: {self.delimiter!r} is none of comma, semicolon, tab, bar"
        if self.decimal not in {None, ".", ","}:
            yield f"decimal: {self.decimal!r} is neither point nor comma"

    def picks(self, sheet: str | None) -> bool:
        """True where a sheet is the one asked for, or none was; ``"2"`` is ``"2: Stress Relaxation"``."""
        wanted = self.sheet
        return wanted is None or (
            sheet is not None and (sheet == wanted or sheet.startswith((f"{wanted}::", f"{wanted}: ")))
        )

    def quantity(self, channel: Channel) -> Quantity:
        """Quantity of a channel: itself, or a strain or stress where the user declared it."""
        return cast("Quantity", self.axes.get(channel, channel))

    @property
    def trial_axes(self) -> Axes:
        """The declared axes, as a trial carries them."""
        return Axes(
            length="1" if self.axes.get("displacement") == "strain" else "mm",
            force="MPa" if self.axes.get("force") == "stress" else "N",
        )
