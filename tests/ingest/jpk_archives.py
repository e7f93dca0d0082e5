"""Synthetic force curves in the archive that a JPK microscope saves, written from the public format facts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray

STIFFNESS_N_PER_M, SENSITIVITY_M_PER_V = 0.05, 5e-8
VOLTS_PER_COUNT, HEIGHT_PER_COUNT, HEIGHT_FACTOR, HEIGHT_ZERO_M = 1e-7, 1e-12, 2.0, 1e-6
RATE_HZ = 250.0


def _properties(values: Mapping[str, object]) -> bytes:
    return ("#Tue\n" + "\n".join(f"{key}={value}" for key, value in values.items())).encode()


def _slot(head: str, slot: str, base: str, multiplier: float, offset: float = 0.0) -> dict[str, object]:
    conversion = f"{head}.conversion-set.conversion.{slot}"
    return {
        f"{head}.conversion-set.conversions.base": "volts",
        f"{conversion}.base-calibration-slot": base,
        f"{conversion}.scaling.multiplier": multiplier,
        f"{conversion}.scaling.offset": offset,
    }


def _encoder(head: str, kind: str, multiplier: float) -> dict[str, object]:
    scaling = f"{head}.encoder.scaling"
    return {f"{head}.encoder.type": kind, f"{scaling}.multiplier": multiplier, f"{scaling}.offset": 0.0}


SHARED: dict[str, object] = {
    **_encoder("lcd-info.0", "signedinteger", VOLTS_PER_COUNT),
    **_slot("lcd-info.0", "distance", "volts", SENSITIVITY_M_PER_V),
    **_slot("lcd-info.0", "force", "distance", STIFFNESS_N_PER_M),
    **_encoder("lcd-info.10", "signedlong-limited", HEIGHT_PER_COUNT),
    **_slot("lcd-info.10", "nominal", "volts", HEIGHT_FACTOR, HEIGHT_ZERO_M),
}


@dataclass(frozen=True)
class Curve:
    """An approach, a hold at constant height and a retract; channels to the last count [s, mm, N]."""

    shared: dict[str, object] = field(default_factory=lambda: dict(SHARED))

    def parts(self) -> list[tuple[FloatArray, FloatArray]]:
        """Height [m] and force [N] of each segment."""
        down, held = 20e-6 - 10e-6 * np.arange(500) / 500, np.full(2000, 10e-6)
        relaxing = 0.5 + 0.5 * np.exp(-np.arange(2000) / 500)
        pressed = 10e-9 * np.maximum(15e-6 - down, 0.0) / 1e-6
        return [(down, pressed), (held, 50e-9 * relaxing), (down[::-1], 0.5 * pressed[::-1])]

    def counts(self) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """What is stored."""
        per_count = STIFFNESS_N_PER_M * SENSITIVITY_M_PER_V * VOLTS_PER_COUNT
        return [
            (
                np.rint((height - HEIGHT_ZERO_M) / HEIGHT_FACTOR / HEIGHT_PER_COUNT).astype(np.int64),
                np.rint(force / per_count).astype(np.int64),
            )
            for height, force in self.parts()
        ]

    def expected(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Time, travel and force of the whole curve, by the arithmetic of the format."""
        height = np.concatenate([one for one, _ in self.counts()])
        force = np.concatenate([one for _, one in self.counts()])
        travel = HEIGHT_FACTOR * (HEIGHT_PER_COUNT * height) + HEIGHT_ZERO_M
        volts = VOLTS_PER_COUNT * force
        return (
            np.arange(height.size) / RATE_HZ,
            travel * 1e3,
            STIFFNESS_N_PER_M * (SENSITIVITY_M_PER_V * volts),
        )

    def files(self, folder: str = "") -> dict[str, bytes]:
        """Members of the archive."""
        found = {"shared-data/header.properties": _properties(self.shared), "header.properties": b"a=b\n"}
        for number, (height, force) in enumerate(self.counts()):
            segment = f"{folder}segments/{number}/"
            head = {
                "force-segment-header.duration": height.size / RATE_HZ,
                "channel.vDeflection.lcd-info.*": 0,
                "channel.measuredHeight.lcd-info.*": 10,
            }
            found[f"{segment}segment-header.properties"] = _properties(head)
            found[f"{segment}channels/measuredHeight.dat"] = height.astype(">i8").tobytes()
            found[f"{segment}channels/vDeflection.dat"] = force.astype(">i4").tobytes()
        return found
