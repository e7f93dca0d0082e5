"""Simulate the recordings of one truth on the samples of a protocol.

Force follows the contact model along the protocol's own x(t) from the contact on, with each log's gain and
contact offset; what the load chain does to it comes on top, and noise last, in air as well.  A calibration
defect acts as in a real machine: the recorded displacement is given, and the tip is where gain and
compliance leave it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter, lfiltic

from tissueid.arrays import FloatArray
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.selfcheck.truth import Truth
from tissueid.synth.path import Path, contact_path
from tissueid.trial import Source, Trial

#: Force is sampled so many times finer than recorded where filter, skew or frame act between samples.
OVERSAMPLED = 8
#: Change of the tip's depth, relative to the deepest, that ends its iteration, and most rounds.
SETTLED = 1e-12
MOST_ROUNDS = 500
#: Steps that differ by less, relative to the longest, are one.
SAME_STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class ProtocolLog:
    """Motion of the tool in one log of a protocol."""

    name: str
    #: (n,): as recorded, both 0 at the expected contact and negative in air before it.
    time_s: FloatArray
    depth_mm: FloatArray  # (n,)
    contact_sd_mm: float  # standard deviation of the depth at which the tool meets the tissue


def noise(
    time_s: FloatArray,
    *,
    sigma_N: float,
    phi: float,
    reference_step_s: float,
    white_share: float,
    rng: np.random.Generator,
) -> FloatArray:
    """White noise plus a stationary AR(1), exact on unequal steps [N].

    ``sigma_N``: standard deviation of the whole; ``phi``: correlation of the AR(1) part over one reference
    step; 0 is white; ``white_share``: share of the variance that is white beside the AR(1) part.
    """
    draws = rng.standard_normal(time_s.size)
    if phi == 0.0:
        return np.asarray(sigma_N * draws)
    step = np.diff(time_s)
    rho = phi ** (step / reference_step_s)
    draws[1:] *= np.sqrt(1.0 - rho**2)
    if step.size and np.ptp(step) <= SAME_STEP * step.max():
        out = lfilter([1.0], [1.0, -float(rho[0])], draws)
    else:
        out = draws.copy()
        for i in range(1, out.size):
            out[i] += rho[i - 1] * out[i - 1]
    if white_share > 0.0:
        out = np.sqrt(1.0 - white_share) * out + np.sqrt(white_share) * rng.standard_normal(out.size)
    return np.asarray(sigma_N * out)


def tip_depth(
    model: ChannelModel, theta: FloatArray, time_s: FloatArray, depth_mm: FloatArray, give: float
) -> FloatArray:
    """Depth of the tip behind a compliance: ``x_tip = x - c F(x_tip)``, solved for the whole path at once.

    Each round takes the step of a tissue as stiff as this one can be, so that it can't overshoot.
    """
    if give == 0.0:
        return depth_mm
    grid = np.linspace(0.0, model.depth_mm, 65)
    slope = np.abs(np.gradient(model.static_force(theta, grid), grid)).max()
    stiff = slope + np.abs(model.stiffness(theta, grid)).sum(axis=0).max()
    varying = (
        np.abs(np.gradient(model.stiffness(theta, grid), grid, axis=1)).sum(axis=0).max() * model.depth_mm
    )
    tip: FloatArray = depth_mm / (1.0 + give * stiff)
    for _ in range(MOST_ROUNDS):
        error = tip + give * model.force(theta, ContactPath(time_s, tip)) - depth_mm
        tip = tip - error / (1.0 + give * (stiff + varying))
        if np.abs(error).max() <= SETTLED * model.depth_mm:
            break
    return tip


def recorded_force(
    model: ChannelModel,
    theta: FloatArray,
    log: ProtocolLog,
    *,
    gain: float,
    offset_mm: float,
    calibration: Mapping[str, float],
) -> FloatArray:
    """Force without noise as the machine records it [N], 0 in air.

    ``gain``, ``offset_mm``: factor of all forces of the log, and how much deeper than expected the tool meets
    the tissue; ``calibration``: ``force_gain`` and ``displacement_gain`` (recorded over true), ``skew_s``
    (force later than displacement), ``force_filter_s`` (first-order low-pass), ``frame_compliance_mm_per_N``;
    what is missing is perfect.
    """
    give = calibration.get("frame_compliance_mm_per_N", 0.0)
    skew, filter_s = calibration.get("skew_s", 0.0), calibration.get("force_filter_s", 0.0)
    time, depth = log.time_s, log.depth_mm / calibration.get("displacement_gain", 1.0)
    if skew != 0.0 or filter_s > 0.0 or give > 0.0:
        samples = np.arange(time.size)
        time = np.interp(np.arange((time.size - 1) * OVERSAMPLED + 1) / OVERSAMPLED, samples, time)
        depth = np.interp(time, log.time_s, depth)
    touched = contact_path(Path(time, depth), offset_mm)
    # the force that bends the frame is the log's own, gain and all
    scaled = theta.copy()
    scaled[model.linear_places] *= gain
    tip = tip_depth(model, scaled, touched.time_s, touched.value_mm, give)
    force = np.interp(time, touched.time_s, model.force(scaled, ContactPath(touched.time_s, tip)))
    # tissue pushes and does not pull
    force = low_pass(time, np.maximum(force, 0.0), filter_s)
    return np.asarray(calibration.get("force_gain", 1.0) * np.interp(log.time_s - skew, time, force))


def low_pass(time_s: FloatArray, force_N: FloatArray, filter_s: float) -> FloatArray:
    """First-order low-pass, exact for a force that is linear between samples."""
    if filter_s == 0.0:
        return force_N
    step = np.diff(time_s)
    ratio = step / filter_s
    decay = np.exp(-ratio)
    # of a ramp over one step the mean lag is (1 - decay) / ratio of its rise
    share = np.where(ratio > 0.0, -np.expm1(-ratio) / np.where(ratio > 0.0, ratio, 1.0), 1.0)
    if step.size and np.ptp(step) <= SAME_STEP * step.max():
        a, s = float(decay[0]), float(share[0])
        weights = [1.0 - s, s - a]
        start = lfiltic(weights, [1.0, -a], [force_N[0]], [force_N[0]])
        rest, _ = lfilter(weights, [1.0, -a], force_N[1:], zi=start)
        return np.concatenate([force_N[:1], rest])
    out = np.empty_like(force_N)
    out[0] = force_N[0]
    for i in range(step.size):
        out[i + 1] = (
            decay[i] * out[i] + (share[i] - decay[i]) * force_N[i] + (1.0 - share[i]) * force_N[i + 1]
        )
    return out


def simulated_trials(
    model: ChannelModel,
    truth: Truth,
    logs: tuple[ProtocolLog, ...],
    *,
    reference_step_s: float,
    white_share: float,
    rng: np.random.Generator,
) -> list[Trial]:
    """All recordings of one truth, noise and all, as a machine would export them."""
    out = []
    for log, gain, offset in zip(logs, truth.gain, truth.offset_mm, strict=True):
        clean = recorded_force(
            model, truth.theta, log, gain=float(gain), offset_mm=float(offset), calibration=truth.calibration
        )
        own = noise(
            log.time_s,
            sigma_N=truth.sigma_N,
            phi=truth.phi,
            reference_step_s=reference_step_s,
            white_share=white_share,
            rng=rng,
        )
        source = Source(path=log.name, recipe="simulated")
        time = log.time_s - log.time_s[0]
        out.append(Trial("simulated", time, log.depth_mm, clean + own, source=source))
    return out
