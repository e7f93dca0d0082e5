"""Terminal of a session: consent, a status line, the Enter key, the summary."""

from __future__ import annotations

import select
import sys
import time
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.output import draw, note
from tissueid.documents import typed
from tissueid.documents.session import Summary
from tissueid.errors import UsageError
from tissueid.store.files import plain_json

if TYPE_CHECKING:
    from tissueid.rendering.recorder import SessionSummary
    from tissueid.rendering.session import Outcome, Wish
    from tissueid.rendering.session_plan import SessionPlan

#: Time between two status lines [s].
SHOW_EVERY_S = 0.1
#: Shares below this are not worth a word.
SMALLEST_SHARE = 5e-4


def ask_for_consent(plan: SessionPlan, *, given: bool, quiet: int) -> None:
    """Print what is to be agreed to, and ask; only motors and people need it.

    Raises UsageError: nobody can be asked; click.Abort: it was refused.
    """
    from tissueid.rendering.session_plan import CONSENT_BLIND, CONSENT_HARDWARE

    texts = [CONSENT_HARDWARE] if plan.capabilities.hardware else []
    texts += [CONSENT_BLIND] if plan.order is not None else []
    if not texts:
        return
    for line in "\n".join(texts).splitlines():
        note(line, quiet=quiet if given else 0)
    if given:
        return
    if not sys.stdin.isatty():
        msg = "consent is needed and nobody can be asked here; give --yes where it was given"
        raise UsageError(msg)
    click.confirm("Do you agree?", abort=True, err=True)


class Keyboard:
    """Enter asks for the next tissue, q and Enter for the end; where there is no terminal, nothing.

    ``switches``: whether there is a tissue to switch to.
    """

    def __init__(self, *, switches: bool) -> None:
        self._heard = sys.stdin is not None and sys.stdin.isatty()
        if self._heard:
            note("Enter: next tissue; q, Enter: end" if switches else "q, Enter: end")

    def __call__(self) -> Wish:
        """Keys typed since the last call; never waits."""
        from tissueid.rendering.session import Wish

        if not self._heard or not select.select([sys.stdin], [], [], 0.0)[0]:
            return Wish()
        line = sys.stdin.readline()
        if not line:
            self._heard = False
            return Wish()
        typed = line.strip().lower()
        return Wish(switch=typed == "", stop=typed in {"q", "quit"})


class StatusLine:
    """One line that is written over and over, on a terminal only."""

    def __init__(self, plan: SessionPlan, *, quiet: bool) -> None:
        self._plan = plan
        self._shown_s = 0.0
        self._on = not quiet and sys.stderr.isatty()

    def __call__(self, record: Any, summary: SessionSummary) -> None:
        """Show a record, unless the last was shown a moment ago."""
        now = time.monotonic()
        if not self._on or now - self._shown_s < SHOW_EVERY_S:
            return
        self._shown_s = now
        draw("\r\x1b[K" + status_text(record, summary, blind=self._plan.order is not None))


def status_text(record: Any, summary: SessionSummary, *, blind: bool) -> str:
    """A record in one line, for eyes and screen readers."""
    from tissueid.haptics.states import Lamp, State

    force = float((record["force_N"] ** 2).sum() ** 0.5)
    lamps = " ".join(str(lamp.name).lower().replace("_", " ") for lamp in Lamp(int(record["lamps"])))
    which = f"presentation {int(record['label'])}  " if blind else ""
    tissue = "" if blind else f" (tissue {float(record['tissue_force_N']):.1f} N)"
    return (
        f"{summary.seconds:7.1f} s  {State(int(record['state'])).name.lower():8} {which}"
        f"depth {float(record['depth_mm']):6.2f} mm  force {force:5.2f} N{tissue}  {lamps}"
    )


def summary_lines(outcome: Outcome) -> list[str]:
    """The session in a few lines."""
    summary = typed(plain_json(outcome.summary), Summary)
    period = summary.period_us
    ended = (
        f"{outcome.message}; {summary.seconds:.1f} s, {summary.ticks} ticks, "
        f"{summary.skipped_ticks} skipped, {summary.lost_records} records lost"
    )
    peak = (
        f"{summary.peak_device_force_N:.3g} N at the device, {summary.peak_tissue_force_N:.4g} N of "
        f"tissue, {summary.deepest_mm:.3g} mm deep; {1e3 * summary.energy_J:.3g} mJ taken from the hand"
    )
    timing = (
        f"{summary.scheduling}; period error median {period.median:.0f}, p99 {period.p99:.0f}, "
        f"p99.9 {period.p99_9:.0f}, max {period.max:.0f} us"
        + ("; TIMING DEGRADED" if summary.timing_degraded else "")
    )
    text = [f"ended      {ended}", f"peak       {peak}", f"timing     {timing}"]
    lit = [
        f"{lamp.replace('_', ' ')} {100.0 * share:.2g} %"
        for lamp, share in summary.shares.items()
        if share >= SMALLEST_SHARE
    ]
    if lit:
        text.append(f"lamps      of the ticks: {', '.join(lit)}")
    if summary.timing_degraded:
        text += [f"remedy     {remedy}" for remedy in outcome.remedies]
    if outcome.log is not None:
        text.append(f"log        {outcome.log}")
    if summary.recording_stopped is not None:
        text.append(f"RECORDING STOPPED before the end: {summary.recording_stopped}")
    return text
