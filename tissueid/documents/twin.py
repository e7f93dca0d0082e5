"""A bundle beside what a test machine found at the grips of its devices (twin.json)."""

from __future__ import annotations

from typing import Literal

from tissueid.documents.base import Document, NonNegative, Positive, Text
from tissueid.documents.contrast import Limit

Verdict = Literal["inside", "outside", "destroyed", "not identified"]


class Row(Document, frozen=True):
    """One number that went in and came out."""

    name: Text
    symbol: Text
    unit: Text
    went_in: float | None  # Of the bundle; null where it is not identified there
    went_in_ci95: tuple[float, float] | None
    came_out: float | None  # Of the recording at the grip; null where counts and delay have destroyed it
    came_out_ci95: tuple[float, float] | None  # With the machine
    verdict: Verdict


class Device(Document, frozen=True):
    """Findings of a machine at the grip of one device."""

    device: Text
    #: Deviation of the force at the grip from the bundle's law along the grip's own path, over its range
    nrmsd_model: NonNegative
    nrmsd_recording: NonNegative | None  # The same from the recording whose travel it is
    #: Of the refit; null of a spectrum and of the yardstick, whose times follow the recording
    fit_nrmsd: NonNegative | None
    noticeable: NonNegative  # Largest difference of force over the just-noticeable one, at the device
    rows: tuple[Row, ...]


class Unseen(Document, frozen=True):
    """A push at a speed that no recording of the bundle had, on the emulated Falcon."""

    speed_mm_s: Positive
    nrmsd_model: NonNegative  # Deviation of the force at the grip from the bundle's law, over its range


class Twin(Document, frozen=True):
    """A bundle beside what its devices gave back."""

    schema: Literal["tissueid/twin/1"]
    specimen: Text
    model: Text
    program: str
    force_scale: Positive  # Device force over tissue force
    motion_scale: Positive  # Device travel over tissue depth
    limit: Limit  # Just-noticeable difference of force
    unseen: Unseen
    devices: tuple[Device, ...]
