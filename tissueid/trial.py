"""Recordings: specimens, protocols, trials, and how a trial was divided into phases.

Units are mm, N and s; conversion happens once, in :mod:`tissueid.ingest`.  A trial keeps the
recording as it was made: signs and zeros are not touched.  Which way is compression, where the tool
met the tissue and what the load cell read in air are decisions, and they live in
:class:`Segmentation`, apart from the data they were made from.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.notebook import Shown

#: Kind of the protocol of a rendered session's log: its force followed its own travel.
RENDERED = "rendered"


def frozen_array(values: Any) -> FloatArray:
    """A read-only float64 copy of one-dimensional values."""
    array = np.array(values, dtype=np.float64, copy=True)
    array.flags.writeable = False
    return array


@dataclass(frozen=True, slots=True)
class Axes:
    """Quantities of a recording's displacement and force.

    A normalised recording holds a length over a length (strain, stretch) or a force over an area (stress).
    All mathematics is the same; only the units of what comes out differ, and such a result can't be
    rendered: a device moves millimetres and pushes newtons.
    """

    length: str = "mm"  # {"mm", "1"}, unit of ``Trial.displacement_mm``
    force: str = "N"  # {"N", "MPa"}, unit of ``Trial.force_N``

    def __post_init__(self) -> None:
        if self.length not in {"mm", "1"} or self.force not in {"N", "MPa"}:
            msg = f"axes are {self.length!r} and {self.force!r}, must be 'mm' or '1', and 'N' or 'MPa'"
            raise ValueError(msg)

    @property
    def normalised(self) -> bool:
        """True where displacement is no length or force is no force."""
        return (self.length, self.force) != ("mm", "N")

    def as_json(self) -> dict[str, str]:
        """The ``units`` object of the schemas."""
        return {"length": self.length, "force": self.force, "time": "s"}

    def unit(self, text: str) -> str:
        """A unit written in mm and N, in the units of these axes.

        >>> Axes("1", "MPa").unit("N s/mm^2")
        'MPa s'
        """
        if not self.normalised:
            return text
        text = re.sub(r"\bN\b", self.force, text.replace("mJ", "N mm"))
        if self.length == "1":
            text = re.sub(r"/mm(\^\d+)?\b", "", text)
            text = re.sub(r"\s?\bmm\b(\^\d+)?", "", text).strip()
        return f"1{text}" if text == "" or text.startswith("/") else text


#: A displacement and a force.
MM_N = Axes()


@dataclass(frozen=True, slots=True)
class Source:
    """Source of a trial."""

    path: str  # file as the user named it
    sheet: str | None = None  # workbook sheet (or block of a several-block file)
    sha256: str = ""  # hash of the file's bytes
    #: Key of the reader that matched, why, and how sure it was from 0 to 1.
    recipe: str = "array"
    #: What the text was read with; ``None`` for binary workbooks.
    encoding: str | None = None
    delimiter: str | None = None
    decimal: str | None = None
    #: ``{"time": name, "displacement": name, "force": name}`` with the names as printed in the file.
    columns: Mapping[str, str] = field(default_factory=dict)
    metadata: Mapping[str, str] = field(default_factory=dict)  # header entries, ``key -> text``, as printed
    recipe_reason: str = ""
    recipe_confidence: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", MappingProxyType(dict(self.columns)))
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))


@dataclass(frozen=True, slots=True)
class Protocol:
    """Program of the machine, as far as the file says so; ``None`` where it does not."""

    kind: str | None = None  # test type in the words of the export (``"comp"``, ``"trelax"``...)
    #: Stated rate [mm/s], depth [mm] and dwell [s].
    speed_mm_s: float | None = None
    depth_mm: float | None = None
    hold_s: float | None = None
    #: Radius of the tool tip [mm]; force at which the machine was to stop or turn [N].
    tip_radius_mm: float | None = None
    load_limit_N: float | None = None


@dataclass(frozen=True, slots=True)
class Trial(Shown):
    """One recording of one push into one specimen.

    Attributes
    ----------
    specimen : str, optional
        Name of the specimen; trials of one name are pooled by :func:`tissueid.identify`.
    time_s, displacement_mm, force_N : ndarray, shape (n,)
        As recorded, converted to s, mm and N, read-only, time non-decreasing.
    protocol : Protocol
    source : Source
    flags : tuple of Flag
        What the reader noticed.
    axes : Axes
        Whether displacement and force are lengths and forces, or normalised.
    """

    specimen: str = "specimen"
    time_s: FloatArray = field(default_factory=lambda: frozen_array(()))
    displacement_mm: FloatArray = field(default_factory=lambda: frozen_array(()))
    force_N: FloatArray = field(default_factory=lambda: frozen_array(()))
    protocol: Protocol = field(default_factory=Protocol)
    source: Source = field(default_factory=lambda: Source(path="<array>"))
    flags: tuple[Flag, ...] = ()
    axes: Axes = MM_N

    def __post_init__(self) -> None:
        for name in ("time_s", "displacement_mm", "force_N"):
            array = frozen_array(getattr(self, name))
            if array.ndim != 1 or array.size < 2:
                msg = f"{name} must be one-dimensional with at least 2 samples, has shape {array.shape}"
                raise ValueError(msg)
            if not np.isfinite(array).all():
                first = int(np.flatnonzero(~np.isfinite(array))[0])
                raise ValueError(f"{name}[{first}] is {array[first]}, every sample must be finite")
            object.__setattr__(self, name, array)
        if not self.time_s.size == self.displacement_mm.size == self.force_N.size:
            raise ValueError("time_s, displacement_mm and force_N differ in length")
        if (np.diff(self.time_s) < 0).any():
            first = int(np.flatnonzero(np.diff(self.time_s) < 0)[0])
            here, then = self.time_s[first : first + 2]
            raise ValueError(f"time_s falls from {here} to {then} s at sample {first + 1}")
        object.__setattr__(self, "flags", tuple(self.flags))

    @property
    def name(self) -> str:
        """Path, and sheet where there is one, for messages."""
        return self.source.path if self.source.sheet is None else f"{self.source.path} [{self.source.sheet}]"


@dataclass(frozen=True, slots=True)
class Phase:
    """A stretch of a recording in which the machine did one thing."""

    #: ``approach`` (moving in, not yet in contact), ``ramp`` (loading), ``hold``, ``creep`` (the load is held
    #: and the tool sinks in: no relaxation hold), ``retract``, ``rest`` (standing out of contact after a
    #: retract), or ``cycle`` (one load-unload loop of a cyclic test).
    kind: str
    #: Sample range ``[start, stop)``; neighbouring phases share their corner sample (``stop - 1`` of one is
    #: ``start`` of the next).
    start: int
    stop: int
    #: Times of the first and last sample [s], as recorded.
    start_s: float
    end_s: float
    #: Speed in the compression direction [mm/s], of the line through 20 to 80 % of the travel; negative while
    #: retracting, 0 in a hold, of a cycle or creep the mean speed.
    speed_mm_s: float
    #: Deepest sample of a cycle, where loading turns to unloading; ``None`` in other phases.
    peak: int | None = None
    braking_s: float = 0.0  # time from leaving that line to the stop [s], 0 where the phase ends otherwise


@dataclass(frozen=True, slots=True)
class Corner:
    """Stop or turn of a ramp."""

    #: The ramp, as an index into :attr:`Segmentation.phases`; the phase after it is what it ends in.
    phase: int
    index: int  # sample nearest to ``time_s``
    time_s: float  # nominal end of the ramp: where its line meets that of the next phase [s]
    duration_s: float  # from leaving the ramp's line to staying on the next phase's, ringing included [s]
    #: Farthest excursion beyond the plateau [mm], 0 where it is within noise and resolution.
    overshoot_mm: float
    #: Excursions to alternate sides of the plateau that exceed noise and resolution, and their mean period
    #: [s]; fewer than two are no ringing, with ``None``.
    ringing_swings: int
    ringing_period_s: float | None


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened at one moment of a recording."""

    #: ``rupture`` (force collapses while the tool moves on), ``abort`` (the test ended before it was over) or
    #: ``load_limit`` (the move ended at a force, not at a depth).
    kind: str
    index: int  # last sample before it
    time_s: float  # its time [s], as recorded
    #: ``name_unit -> number``.  Rupture: ``force_before_N``, ``drop_N``, ``drop_fraction``, ``depth_mm``
    #: (below contact), ``work_N_mm`` (from contact).  Abort: ``reached_mm`` and what was asked for, as far as
    #: it is known (``stated_mm``, ``stated_hold_s``, or ``travel_mm`` and ``earlier_mm``).  Load limit:
    #: ``force_N``, ``depth_mm`` and ``creep_mm``, ``turns`` or ``limit_N``.
    values: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", MappingProxyType(dict(self.values)))


@dataclass(frozen=True, slots=True)
class Contact:
    """Contact of tool and tissue."""

    index: int  # first sample in contact; 0 where the recording starts in contact
    #: Displacement of contact as recorded [mm]; may lie before the first sample (preloaded start).
    displacement_mm: float
    sd_mm: float  # standard deviation of that displacement [mm]
    baseline_N: float = 0.0  # load-cell reading in air [N] as recorded; 0 where there are no samples in air
    in_record: bool = False  # true where the recording shows the tool in air before contact
    moved_mm: float = 0.0  # how far from here the tool met the tissue after loops, which ``sd_mm`` holds

    @property
    def first_sd_mm(self) -> float:
        """Standard deviation of the place where the tool first met the tissue [mm]."""
        return math.sqrt(max(self.sd_mm**2 - self.moved_mm**2, 0.0))


@dataclass(frozen=True, slots=True)
class Segmentation:
    """Division of a trial; made by :mod:`tissueid.segment`, corrected by the user."""

    compression_sign: int  # +1 where recorded displacement grows into the tissue, -1 where it falls
    force_sign: int  # +1 where recorded force grows with compression, -1 where it falls
    contact: Contact | None  # ``None`` where no contact was found
    phases: tuple[Phase, ...]  # in time order
    force_noise_N: float  # standard deviation of the force noise [N], from successive differences
    flags: tuple[Flag, ...] = ()
    corners: tuple[Corner, ...] = ()  # one for each ramp that stops or turns, in time order
    events: tuple[Event, ...] = ()  # in time order
    test: int = 0  # phase with which the test proper begins, after preconditioning cycles; 0 without them

    def of_kind(self, kind: str) -> tuple[Phase, ...]:
        """The phases of one kind, in time order."""
        return tuple(phase for phase in self.phases if phase.kind == kind)


def contact_frame(trial: Trial, segmentation: Segmentation) -> tuple[FloatArray, FloatArray]:
    """Indentation depth and compressive force, zero at contact.

    ``segmentation``: must have a contact.  Returns ``depth_mm, force_N`` (n,): depth below the contact point
    [mm] (negative in air) and compressive force above the reading in air [N].
    """
    contact = segmentation.contact
    if contact is None:
        raise ValueError(f"{trial.name}: no contact point, so there is no contact frame")
    depth = segmentation.compression_sign * (trial.displacement_mm - contact.displacement_mm)
    force = segmentation.force_sign * (trial.force_N - contact.baseline_N)
    return depth, force
