"""Answers of the segmenter in a word each, and recordings to ask it about."""

import numpy as np

from tissueid.flags import Flag
from tissueid.segment import SegmentOptions, segment
from tissueid.synth import Hold, Log, Move, Recipe, as_trials, simulate
from tissueid.trial import Event, Segmentation, Trial


def simulated(*moves: Move | Hold, seed: int | np.random.Generator = 0, **settings) -> Trial:
    recipe = Recipe("r", (Log("r", moves),), **settings)
    return as_trials(simulate(recipe, rng=np.random.default_rng(seed)))[0]


def normal(sd: float, like: np.ndarray, seed: int) -> np.ndarray:
    """White noise for every sample, from a generator of its own."""
    return np.random.default_rng(seed).normal(0.0, sd, like.size)


def divided(time_s, travel_mm, force_N, **options) -> Segmentation:
    return segment(Trial("log", time_s, travel_mm, force_N), options=SegmentOptions(**options))


def kinds(found: Segmentation) -> list[str]:
    return [phase.kind for phase in found.phases]


def codes(found: Segmentation) -> set[str]:
    return {flag.code for flag in found.flags}


def flag_of(found: Segmentation, code: str) -> Flag:
    (flag,) = [one for one in found.flags if one.code == code]
    return flag


def events(found: Segmentation, kind: str) -> list[Event]:
    return [event for event in found.events if event.kind == kind]
