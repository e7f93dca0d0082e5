"""Signs of compression and of the recorded force."""

from __future__ import annotations

import numpy as np

from tissueid.flags import Flag
from tissueid.segment.options import SegmentOptions
from tissueid.segment.spikes import without_spikes
from tissueid.signal_noise import white_noise_sd
from tissueid.trial import Trial

#: The other excursion reaches this share of the dominant one: the direction is doubtful.
DOUBTFUL_EXCURSION = 0.5
#: Share of the force's own change that its change over the travel must reach to have a sign.
DOUBTFUL_FORCE = 0.3
#: Samples that tell the first level of the force.
FIRST_SAMPLES = 5


def signs(trial: Trial, options: SegmentOptions) -> tuple[int, int, list[Flag]]:
    """Signs of compression and of force, with what is doubtful about them.

    Returns ``compression_sign, force_sign``; ``flags``.
    """
    flags: list[Flag] = []
    x, force = trial.displacement_mm, trial.force_N
    out, back = float(x.max() - x[0]), float(x[0] - x.min())
    compression = options.compression_sign
    if compression is None:
        compression = 1 if out >= back else -1
        minor, major = sorted((out, back))
        if major > 0.0 and minor > DOUBTFUL_EXCURSION * major:
            flags.append(
                Flag(
                    "sign_assumed",
                    f"displacement goes {out:.4g} mm one way, {back:.4g} mm the other; the larger was taken",
                    {"positive_mm": out, "negative_mm": back, "compression_sign": compression},
                )
            )
    depth = compression * (x - x[0])
    force_sign = options.force_sign
    # force at the deepest part against force at the start of the travel
    deep, shallow = depth >= 0.8 * depth.max(), depth <= 0.2 * depth.max()
    change = float(np.median(force[deep]) - np.median(force[shallow])) if depth.max() > 0.0 else 0.0
    if force_sign is None:
        force_sign = -1 if change < 0.0 else 1
        # a specimen that broke, or relaxed after a fast start, may carry less at its deepest: where force
        # leaves its first level to one side only, that side tells
        calm = without_spikes(force, noise=white_noise_sd(trial.time_s, force))
        level = float(np.median(calm[:FIRST_SAMPLES]))
        rise, fall = float(calm.max()) - level, level - float(calm.min())
        doubtful = abs(change) < DOUBTFUL_FORCE * float(np.ptp(force))
        if doubtful or min(rise, fall) < DOUBTFUL_FORCE * max(rise, fall):
            force_sign = 1 if rise >= fall else -1
        if doubtful:
            flags.append(
                Flag(
                    "sign_assumed",
                    f"force changes by {change:.4g} N over the travel but by {np.ptp(force):.4g} N in all; "
                    f"force_sign {force_sign:+d} was taken",
                    {"change_N": change, "range_N": float(np.ptp(force)), "force_sign": force_sign},
                )
            )
    stated = (trial.protocol.kind or "").lower()
    if stated.startswith("tens"):
        flags.append(
            Flag(
                "tension", f"the file says {trial.protocol.kind!r}: the specimen is pulled", {"kind": stated}
            )
        )
    elif force_sign != compression:
        flags.append(
            Flag(
                "tension",
                "recorded force and displacement have opposite signs: force against the travel, or tension",
                {"compression_sign": compression, "force_sign": force_sign},
            )
        )
    return compression, force_sign, flags
