"""Rendering of a tissue, as rows and words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tissueid.digits import number
from tissueid.documents.identification import Specimen
from tissueid.documents.session import Scale


@dataclass(frozen=True, slots=True)
class RenderedDevice:
    """One device that would render a tissue: its scales, and what lies outside validity."""

    name: str
    scale: Scale
    travel_mm: float  # of the grip, for all the depth that is valid
    room_mm: float  # of the device
    fastest_hand_mm_s: float  # that stays within the identified speeds
    faster_than_identified: bool  # a hand that explores leaves them

    @property
    def outside_share(self) -> float:
        """Share of the device's travel that lies deeper than the data."""
        return max(1.0 - self.travel_mm / self.room_mm, 0.0)


@dataclass(frozen=True, slots=True)
class RefusedDevice:
    """One device that a tissue is not rendered on."""

    name: str
    why: str


@dataclass(frozen=True, slots=True)
class Rendering:
    """Passivity of a law and of its draws, and the devices that would render it."""

    passive: bool
    draws: int
    draws_passive: int
    unique: bool
    devices: tuple[RenderedDevice | RefusedDevice, ...]


#: Rendering of a specimen whose recordings were normalised: there is none.
NORMALISED = "normalised"


def _device(row: RenderedDevice | RefusedDevice, depth_mm: float) -> dict[str, Any]:
    if isinstance(row, RefusedDevice):
        return {"name": row.name, "refused": row.why, "remarks": ()}
    scale, fastest = row.scale, number(row.fastest_hand_mm_s, 3)
    cells = [
        f"measured / {number(scale.felt_force_is_measured_over, 3)}",
        f"measured / {number(scale.felt_stiffness_is_measured_over, 3)}",
        f"× {scale.motion_scale:g}",
        f"{number(scale.peak_force_N, 3)} of {number(scale.clamp_N, 3)} N",
        f"{number(scale.required_damping_N_s_per_m, 2)} of {number(scale.device_damping_N_s_per_m, 2)} N·s/m",
        f"{100 * (scale.clipped_share_expected or 0.0):.0f} %",
        f"{100 * row.outside_share:.0f} %",
        f"{fastest} mm/s",
    ]
    remarks = [f"numbers of this device: {scale.known}"]
    if scale.lowered_from_force_scale is not None:
        wanted = number(1.0 / scale.lowered_from_force_scale, 3)
        remarks.append(f"lowered from measured / {wanted} so that the device's damping keeps it stable")
    remarks.append(
        f"{number(depth_mm, 3)} mm of tissue are {number(row.travel_mm, 3)} mm of the "
        f"{number(row.room_mm, 3)} mm of travel; deeper, the law is continued beyond the data"
    )
    if row.faster_than_identified:
        remarks.append(f"a hand that moves faster than {fastest} mm/s leaves the identified speeds")
    return {"name": row.name, "refused": None, "cells": cells, "remarks": [*remarks, *(scale.remarks or ())]}


def rendering_view(rendering: Rendering | str | None, specimen: Specimen) -> dict[str, Any] | None:
    """Rows of devices and sentences on passivity; ``None`` where nothing was worked out."""
    if rendering is None:
        return None
    if isinstance(rendering, str):
        said = (
            "The recordings were normalised, and a device moves millimetres and pushes newtons: this bundle "
            "can't be rendered."
        )
        return {"said": said, "devices": None}
    draws = rendering.draws
    shares = f"; so are {rendering.draws_passive} of {draws} posterior draws" if draws else ""
    passive = (
        f"The law is passive{shares}: it never gives back more energy than it took."
        if rendering.passive
        else "The law is not passive: it is refused by every renderer."
    )
    unique = (
        ""
        if rendering.unique
        else " Where the tool lets go, the surface may jump while it recovers (contact loss is not unique)."
    )
    devices = [_device(row, specimen.validity.depth_mm) for row in rendering.devices]
    return {"said": f"{passive}{unique}", "devices": devices}
