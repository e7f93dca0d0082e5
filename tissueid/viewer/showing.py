"""A session, or its log, on a viewer: plans, heads and the expected force to the hello and its memories."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import BundleError, UsageError
from tissueid.model.channels import loading_force
from tissueid.rendering.session_plan import SessionPlan
from tissueid.rendering.tissue_block import Tissue
from tissueid.store.bundle import load_bundle
from tissueid.store.session_log import SessionLog, read_session_log
from tissueid.viewer.hello import hello
from tissueid.viewer.serving import ServedViewer

if TYPE_CHECKING:
    from tissueid.rendering.servo import ServoProcess

#: Depths of a curve.
POINTS = 41
LOW, HIGH = 0.025, 0.975
#: Draws the band is made of: the 2.5 % quantile of 400 has a standard error of 0.8 % of them.
MOST_DRAWS = 400
#: Samples of a recording that is drawn beside a log.
MOST_BESIDE = 4_000


def band_of(tissue: Tissue, draws: FloatArray | None) -> dict[str, Any]:
    """Force over depth at the slowest and the fastest identified speed, with quantiles of draws (m, p).

    Pointwise 2.5 and 97.5 % quantiles of the force reached from rest at that speed
    (:func:`~tissueid.model.channels.loading_force`).
    """
    depth = np.linspace(0.0, tissue.model.depth_mm, POINTS)
    used = np.zeros((0, tissue.theta.size)) if draws is None else draws[:: max(1, len(draws) // MOST_DRAWS)]
    curves = []
    for speed in sorted(set(tissue.speeds_mm_s)):
        curve = {
            "speed_mm_s": float(speed),
            "depth_mm": depth.tolist(),
            "force_N": loading_force(tissue.model, tissue.theta, depth, speed_mm_s=speed).tolist(),
        }
        if len(used):
            forces = [loading_force(tissue.model, draw, depth, speed_mm_s=speed) for draw in used]
            low, high = np.quantile(forces, [LOW, HIGH], axis=0)
            curve |= {"low_N": low.tolist(), "high_N": high.tolist()}
        curves.append(curve)
    return {"draws": len(used), "curves": curves}


def show_session(viewer: ServedViewer, plan: SessionPlan, servo: ServoProcess, bundle: Path | None) -> None:
    """Show what a servo renders, with its hand where a pointer may lead it, and the bundle's band."""
    band = None
    if plan.picked and plan.order is None:
        band = band_of(plan.picked[0].tissue, None if bundle is None else load_bundle(bundle).draws)
    workspace_m = [[float(low), float(high)] for low, high in plan.capabilities.workspace_m]
    words = hello(plan.head, workspace_m=plan.capabilities.workspace_m, pointer=plan.led, band=band)
    reading = servo.ring.read_only()
    try:
        descriptors, rest_m = [reading], None
        if servo.hand is not None:
            descriptors.append(servo.hand.descriptor)
            rest_m = [float(value) for value in plan.device_options["hand"].start_m]
            viewer.let_go = partial(servo.hand.point_at, rest_m)
            viewer.silent_s = servo.hand.silent_s
        viewer.show_live(words, descriptors, rest_m=rest_m, workspace_m=workspace_m)
    finally:
        os.close(reading)


def check_log(path: Path) -> SessionLog:
    """A log with something in it; BundleError: it can't be read, or holds no two ticks."""
    log = read_session_log(path)
    if log.records.size < 2:
        msg = f"{path}: the log holds {log.records.size} ticks, there is nothing to see"
        raise BundleError(msg)
    return log


def recording_beside(log: SessionLog, path: Path) -> dict[str, list[float]]:
    """A recording to be drawn beside a log, in its time: both cross the surface at the same time.

    Raises UsageError: one of them never touches tissue.
    """
    # what the first picture of a session need not wait for
    from tissueid.ingest import read_trials
    from tissueid.segment import segment
    from tissueid.trial import contact_frame

    trial = read_trials(path)[0]
    found = segment(trial)
    inside = np.flatnonzero(log.records["depth_mm"] > 0.0)
    if found.contact is None or not inside.size:
        whose = path if found.contact is None else "the log"
        msg = f"{whose}: there is no contact in it, by which the two could be laid beside each other"
        raise UsageError(msg)
    depth, force = contact_frame(trial, found)
    met_s = float(log.records["time_s"][inside[0]])
    time_s = trial.time_s - trial.time_s[found.contact.index] + met_s
    every = max(1, time_s.size // MOST_BESIDE)
    return {
        "time_s": time_s[::every].tolist(),
        "depth_mm": depth[::every].tolist(),
        "force_N": force[::every].tolist(),
    }


def show_log(
    viewer: ServedViewer, log: SessionLog, path: Path, beside: Mapping[str, list[float]] | None = None
) -> None:
    """Play a log of :func:`check_log`, which the server reads again, ``beside`` a recording."""
    times = log.records["time_s"]
    viewer.show_log(hello(log.head, replay_s=float(times[-1] - times[0]), beside=beside), path)
