"""Identified tissues beside each other."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from tissueid.documents.base import Count, Document, Fraction, NonNegative, Positive, PositiveCount


class Common(Document, frozen=True):
    """Depth and speeds that both tissues were tested at."""

    depth_mm: Positive
    speeds_mm_s: tuple[float, float]


class Device(Document, frozen=True):
    """Device the tissues would be felt on."""

    clamp_N: float
    force_scale: float


class Tissue(Document, frozen=True):
    """Tissue that is compared."""

    name: str
    branches: int
    stiffness_degree: int
    draws: int
    interval: Literal["statistical", "total"]


#: One value a point
Row = Annotated[tuple[float, ...], Meta(min_length=2)]


class Loading(Document, frozen=True):
    """Force along a ramp [N], median and central 95 %."""

    speed_mm_s: float
    depth_mm: Row
    low: Row
    median: Row
    high: Row


class Hold(Document, frozen=True):
    """After the fastest common ramp to the common depth."""

    time_s: Row
    low: Row
    median: Row
    high: Row


class Curve(Document, frozen=True):
    """Forces of one tissue, along ramps and in holds."""

    name: str
    loading: Annotated[tuple[Loading, ...], Meta(min_length=1)]
    hold: Hold  # After the fastest common ramp to the common depth


class Difference(Document, frozen=True):
    """Distance of two tissues in force space, and how sure its direction is."""

    distance: NonNegative
    directions: PositiveCount
    probability: Fraction
    different: bool


#: 2.5, 50, 97.5 %
Quantiles = tuple[float, float, float]


class Number(Document, frozen=True):
    """One number of both tissues, and their ratio."""

    name: str
    one: Quantiles
    other: Quantiles
    ratio: Quantiles | None  # other over one
    larger: Fraction  # Probability that the other one's is larger


class Limit(Document, frozen=True):
    """Published just-noticeable difference."""

    of: str
    share: float
    source: str
    doi: str
    conditions: str


class Noticed(Document, frozen=True):
    """Difference in units of a just-noticeable difference."""

    name: str
    limit: Limit
    times: NonNegative  # Median
    interval: tuple[NonNegative, NonNegative]  # Central 95 %, from 0 where either may have more
    probability: Fraction  # That it exceeds one, in the direction of its median


class Pair(Document, frozen=True):
    """Two tissues against each other."""

    one: str
    other: str
    difference: Difference
    numbers: tuple[Number, ...]
    noticed: tuple[Noticed, ...]
    hand: str  # Whether it could tell, where that is known


class Contrast(Document, frozen=True):
    """Tissues against each other, and against a hand."""

    schema: Literal["tissueid/contrast/1"]
    tissueid: str
    level: float  # Tissues are called different below this probability
    common: Common
    device: Device
    tissues: Annotated[tuple[Tissue, ...], Meta(min_length=2)]
    curves: Annotated[tuple[Curve, ...], Meta(min_length=2)]  # Forces of every tissue, in their order
    pairs: tuple[Pair, ...]
    remarks: tuple[str, ...] = ()  # What the intervals do not know
    measured: tuple[MeasuredPair, ...] | None = None  # Measured, no model, pair by pair; of output folders


class Side(Document, frozen=True):
    """One number of one side."""

    mean: float | None
    sd: float | None  # Between logs
    count: Count
    ramp_time_s: tuple[float, float] | None


class MeasuredNumber(Document, frozen=True):
    """Measured number of both sides, and their ratio."""

    name: str
    unit: str
    #: Logs of one speed and depth; those with holds first and the deepest of them first
    program: PositiveCount
    hold: Count
    time_s: float | None  # After the stop
    one: Side
    other: Side
    ratio: float | None  # Of other over one
    reason: str | None  # Why they are not compared
    depth_mm: float | None = None  # Below contact, of a force while loading


class MeasuredPair(Document, frozen=True):
    """Two sets of recordings against each other."""

    one: str
    other: str
    numbers: tuple[MeasuredNumber, ...]


class MeasuredContrast(Document, frozen=True):
    """Recordings against each other, without a model."""

    schema: Literal["tissueid/measured-contrast/1"]
    tissueid: str
    pairs: tuple[MeasuredPair, ...]
