"""Compose signs, motion and contact into the phases of a recording."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tissueid.flags import Flag
from tissueid.segment.contact import find_contact
from tissueid.segment.motion import Piece, displacement_tolerance, pieces
from tissueid.segment.noise import white_noise_sd
from tissueid.segment.options import SegmentOptions
from tissueid.segment.signs import signs
from tissueid.trial import Contact, Phase, Segmentation, Trial

__all__ = ["segment"]

FloatArray = NDArray[np.float64]

#: Fewest samples with which there is anything to divide.
FEWEST_SAMPLES = 5
#: A hold has at least so many samples: fewer cannot show a decay beside its plateau.
HOLD_SAMPLES = 8
#: A hold lasts at least this share of its ramp: a crosshead takes 50-300 ms to stop or to turn, and that
#: dwell, seen after a ramp of 10-60 s, is no relaxation test.
HOLD_SHARE_OF_RAMP = 0.05
#: A way back this small against its ramp, ended by a standstill, is overshoot of the stop, not a retract.
OVERSHOOT_SHARE = 0.1
#: A loop returns at least this share of its way in.
LOOP_RETURN = 0.5
#: Loops from which a recording is cyclic.
FEWEST_LOOPS = 2
#: Overshoot beyond this share of the ramp is said.
OVERSHOOT_SAID = 0.002
#: A ramp that ends this share short of the stated depth was aborted.
ABORT_SHARE = 0.05


def segment(trial: Trial, *, options: SegmentOptions | None = None) -> Segmentation:
    """Divide a recording into phases and find its contact point.

    Parameters
    ----------
    trial : Trial
    options : SegmentOptions, optional
        What the user decides instead of the data.

    Returns
    -------
    Segmentation
        ``contact`` is ``None`` where none was found, and no hold is in ``phases`` where there is none: both
        are results, with a flag.
    """
    options = options or SegmentOptions()
    compression, force_sign, flags = signs(trial, options)
    time_s, depth, force = trial.time_s, compression * trial.displacement_mm, force_sign * trial.force_N
    if time_s.size < FEWEST_SAMPLES or np.ptp(depth) == 0.0:
        message = f"{time_s.size} samples over {np.ptp(depth):.3g} mm of travel: nothing to divide"
        values = {"n_samples": time_s.size, "travel_mm": float(np.ptp(depth))}
        few = [Flag("too_few_samples", message, values), Flag("no_hold", message, values)]
        return Segmentation(compression, force_sign, None, (), white_noise_sd(time_s, force), (*flags, *few))
    found = _settle(depth, pieces(time_s, depth))
    found = _drop_short_stands(time_s, found, options)
    noise = white_noise_sd(time_s, force)
    loading = [piece for piece in found if piece.direction > 0]
    contact, contact_flags = find_contact(
        depth, force, loading, noise_N=noise, signs=(compression, force_sign), options=options
    )
    kinds = _kinds(depth, found, contact)
    phases = tuple(_phase(time_s, depth, kind, piece) for kind, piece in kinds)
    flags += contact_flags
    flags += _phase_flags(trial, depth, phases)
    flags += _corner_flags(time_s, depth, phases)
    return Segmentation(compression, force_sign, contact, phases, noise, tuple(flags))


def _settle(depth: FloatArray, found: list[Piece]) -> list[Piece]:
    """Overshoot and ringing before a standstill belong to the ramp."""
    result: list[Piece] = []
    k = 0
    while k < len(found):
        ramp = found[k]
        stop = k
        if ramp.direction > 0:
            travel = depth[ramp.stop] - depth[ramp.start]
            while (
                stop + 1 < len(found)
                and found[stop + 1].direction != 0
                and abs(depth[found[stop + 1].stop] - depth[found[stop + 1].start])
                <= OVERSHOOT_SHARE * travel
            ):
                stop += 1
            if stop > k and stop + 1 < len(found) and found[stop + 1].direction == 0:
                ramp = replace(ramp, stop=found[stop].stop)
            else:
                stop = k
        result.append(ramp)
        k = stop + 1
    return result


def _drop_short_stands(time_s: FloatArray, found: list[Piece], options: SegmentOptions) -> list[Piece]:
    """Standstills too short to be holds go to the move before; neighbours that then agree are joined."""
    result: list[Piece] = []
    for piece in found:
        if piece.direction == 0 and result and not _long_enough(time_s, piece, result[-1], options):
            result[-1] = replace(result[-1], stop=piece.stop)
        else:
            result.append(piece)
    return result


def _long_enough(time_s: FloatArray, stand: Piece, before: Piece, options: SegmentOptions) -> bool:
    duration = float(time_s[stand.stop] - time_s[stand.start])
    if options.minimum_hold_s is not None:
        return duration >= options.minimum_hold_s
    moved = float(time_s[before.stop] - time_s[before.start])
    return stand.stop - stand.start + 1 >= HOLD_SAMPLES and duration >= HOLD_SHARE_OF_RAMP * moved


def _kinds(depth: FloatArray, found: list[Piece], contact: Contact | None) -> list[tuple[str, Piece]]:
    """Name each piece; moves before contact are approach, repeated loops are cycles."""
    touched = depth.size if contact is None else contact.index
    named: list[tuple[str, Piece]] = []
    loaded = False
    for piece in found:
        if (
            contact is not None
            and contact.in_record
            and piece.start < touched < piece.stop
            and piece.direction > 0
        ):
            named += [("approach", replace(piece, stop=touched)), ("ramp", replace(piece, start=touched))]
            loaded = True
        elif contact is not None and contact.in_record and piece.stop <= touched:
            named.append(("approach", piece))
        elif piece.direction > 0:
            named.append(("ramp" if contact is not None else "approach", piece))
            loaded = True
        elif piece.direction < 0:
            named.append(("retract", piece))
        else:
            # a standstill before anything was loaded is not a hold: there is nothing to relax
            named.append(("hold" if loaded and contact is not None else "approach", piece))
    return _cycles(depth, named)


def _cycles(depth: FloatArray, named: list[tuple[str, Piece]]) -> list[tuple[str, Piece]]:
    """Join each loading and the unloading right after it where the recording repeats them."""
    loops = [
        k
        for k in range(len(named) - 1)
        if named[k][0] == "ramp"
        and named[k + 1][0] == "retract"
        and depth[named[k + 1][1].start] - depth[named[k + 1][1].stop]
        >= LOOP_RETURN * (depth[named[k][1].stop] - depth[named[k][1].start])
    ]
    if len(loops) < FEWEST_LOOPS:
        return named
    joined: list[tuple[str, Piece]] = []
    k = 0
    while k < len(named):
        if k in loops:
            joined.append(("cycle", Piece(0, named[k][1].start, named[k + 1][1].stop)))
            k += 2
        else:
            joined.append(named[k])
            k += 1
    return joined


def _phase(time_s: FloatArray, depth: FloatArray, kind: str, piece: Piece) -> Phase:
    start_s, end_s = float(time_s[piece.start]), float(time_s[piece.stop])
    moved = float(depth[piece.stop] - depth[piece.start])
    speed = moved / (end_s - start_s) if end_s > start_s and piece.direction != 0 else 0.0
    return Phase(kind, piece.start, piece.stop + 1, start_s, end_s, speed)


def _phase_flags(trial: Trial, depth: FloatArray, phases: tuple[Phase, ...]) -> list[Flag]:
    """What the list of phases says about the test."""
    flags: list[Flag] = []
    count = {
        kind: sum(phase.kind == kind for phase in phases) for kind in ("ramp", "hold", "cycle", "retract")
    }
    if count["cycle"]:
        message = f"{count['cycle']} load-unload loops"
        flags.append(Flag("cyclic", message, {"loops": count["cycle"]}))
    if not count["ramp"] and not count["cycle"]:
        flags.append(Flag("no_ramp", "no loading ramp was found"))
    if not count["hold"]:
        flags.append(Flag("no_hold", "no hold was found: there is nothing to relax"))
    if count["hold"] > 1 and count["ramp"] > 1:
        message = f"{count['hold']} holds after {count['ramp']} ramps"
        flags.append(Flag("several_steps", message, {"ramps": count["ramp"], "holds": count["hold"]}))
    stated = trial.protocol.depth_mm
    ramps = [phase for phase in phases if phase.kind == "ramp"]
    if stated and ramps and not count["hold"] and not count["cycle"]:
        reached = float(depth[ramps[0].stop - 1] - depth[0])
        if reached < (1.0 - ABORT_SHARE) * stated:
            message = f"the ramp ends at {reached:.4g} mm of the stated {stated:.4g} mm"
            flags.append(Flag("aborted_ramp", message, {"reached_mm": reached, "stated_mm": stated}))
    return flags


def _corner_flags(time_s: FloatArray, depth: FloatArray, phases: tuple[Phase, ...]) -> list[Flag]:
    """Overshoot where a ramp ends in a hold."""
    tolerance = displacement_tolerance(time_s, depth)
    for before, after in pairwise(phases):
        if (before.kind, after.kind) != ("ramp", "hold"):
            continue
        plateau = float(np.median(depth[after.start : after.stop]))
        travel = plateau - float(depth[before.start])
        middle = (before.start + before.stop) // 2
        beyond = depth[middle : after.stop] - plateau
        overshoot = float(beyond.max())
        if overshoot > max(OVERSHOOT_SAID * travel, tolerance):
            outside = np.flatnonzero(beyond > tolerance)
            duration = float(time_s[middle + outside[-1]] - time_s[middle + outside[0]])
            message = f"displacement overshoots its hold by {overshoot:.3g} mm for {duration:.3g} s"
            return [Flag("corner_overshoot", message, {"overshoot_mm": overshoot, "duration_s": duration})]
    return []
