"""A session, or its log, on a viewer: from plans and heads to the hello and the memories it needs."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tissueid.errors import BundleError
from tissueid.rendering.session_plan import SessionPlan
from tissueid.store.bundle import load_bundle
from tissueid.store.session_log import SessionLog, read_session_log
from tissueid.viewer.band import band_of
from tissueid.viewer.hello import hello
from tissueid.viewer.serving import ServedViewer

if TYPE_CHECKING:
    from tissueid.rendering.servo import ServoProcess


def show_session(viewer: ServedViewer, plan: SessionPlan, servo: ServoProcess, bundle: Path | None) -> None:
    """Show what a servo renders.

    ``servo``: its ring is handed over for reading, and the hand where the plan lets a pointer lead it;
    ``bundle``: where the plan's first tissue comes from, for the band of its draws.
    """
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
    """A log with something in it.

    Raises BundleError: it can't be read, or holds no two ticks.
    """
    log = read_session_log(path)
    if log.records.size < 2:
        msg = f"{path}: the log holds {log.records.size} ticks, there is nothing to see"
        raise BundleError(msg)
    return log


def show_log(viewer: ServedViewer, log: SessionLog, path: Path) -> None:
    """Play a log.

    ``log``: :func:`check_log`; ``path``: where it lies; the server reads it again.
    """
    times = log.records["time_s"]
    viewer.show_log(hello(log.head, replay_s=float(times[-1] - times[0])), path)
