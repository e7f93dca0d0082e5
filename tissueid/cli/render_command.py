"""``tissueid render``: feel an identified tissue on a device, or on the screen's simulated one."""

from __future__ import annotations

import select
import sys
import time
from collections.abc import Callable
from contextlib import closing, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.completion_command import presets, scenes
from tissueid.cli.devices_command import WayFlags, asked_device
from tissueid.cli.flags import ABOVE_0, BUNDLE, argument, option, subcommand, typed
from tissueid.cli.output import draw, echo, echo_json, note, progress_bar
from tissueid.cli.view_command import ViewerFlags, announce, served, telling_stop
from tissueid.errors import DeviceError, exit_code, refuse

if TYPE_CHECKING:
    from tissueid.rendering.options import RenderOptions
    from tissueid.rendering.recorder import SessionSummary
    from tissueid.rendering.scene import Scene
    from tissueid.rendering.servo import ServoProcess
    from tissueid.rendering.servo_spawn import SpawnedServo
    from tissueid.rendering.session import Outcome, Session, Wish
    from tissueid.rendering.session_plan import SessionPlan
    from tissueid.viewer.serving import ServedViewer

#: Options that choose among the draws of bundles.
_CHOICES = ("draw", "draw_specimen", "quantile", "against", "against_draw", "against_quantile")
#: Options of a tissue, which a scene may have too, and those that go to the session under their own name.
_TISSUE = ("bundle", "preset", "force_scale", "motion_scale", "surface")
_ALIKE = (
    *_CHOICES, "of", "script", "seconds", "environment", "blind", "presentations", "pseudonym", "replay",
    "virtual",
)  # fmt: skip
#: Options that mean nothing without another one.
_PARTS = {
    "viewer": ("host", "viewer_port", "certificate", "certificate_key"),
    "bridge": ("bridge_token",),
    "blind": ("key",),
    "twin": ("felt", "out"),
}
#: What is felt where nothing was asked for.
DEMONSTRATED = "paper-a"


class RenderFlags(WayFlags, ViewerFlags):
    """Everything that a session is asked for with."""

    # fmt: off
    bundle: Path | None = argument(required=False, type=BUNDLE)
    # the tissue that is felt
    preset: str | None = option(
        "A tissue that comes along: paper-a, meat.", metavar="NAME", shell_complete=presets
    )
    draw: int | None = option("Feel posterior draw N instead of theta, the bundle's own values.", metavar="N")
    draw_specimen: str | None = option(
        "Feel a specimen drawn from a population.h5; without a seed another each time.",
        metavar="[SEED]", is_flag=False, flag_value="new",
    )
    quantile: float | None = option("Feel the draw nearest this quantile of --of.", metavar="Q")
    of: str = option(
        "Which number the quantile, and the comparison of two tissues, is of.",
        default="force at 6 mm, 250 mm/min",
    )
    against: Path | None = option(
        "A second tissue; Enter switches. With --twin, the recording whose travel is driven.",
        metavar="BUNDLE",
        type=BUNDLE,
    )
    against_draw: int | None = option("... of this draw.", metavar="N")
    against_quantile: float | None = option("... of this quantile.", metavar="Q")
    environment: str | None = option("An installed force law instead of a tissue.", metavar="NAME")
    scene: str | None = option(
        "A scene.toml, or one that comes along: hip-resurfacing, meat, orbital-floor.",
        metavar="NAME|FILE", shell_complete=scenes,
    )
    plan: Path | None = option("Axis and entry point to be guided to, instead of the scene's.")
    # its scale and surface
    force_scale: float | None = option("Device force over tissue force.", metavar="S")
    motion_scale: float | None = option("Device travel over tissue depth. [default: 5]", metavar="S")
    surface: str | None = option(
        "'plane', 'sphere R mm' or 'box X x Y x Z mm', in tissue units. [default: plane]"
    )
    tip_radius: float | None = option(
        "Radius of the tool tip; another than identified is refused.", type=ABOVE_0, metavar="MM"
    )
    no_control: bool = option("The passivity controller only watches.")
    # the session
    name: str = option(
        "auto, or one of tissueid devices list.", "--device", default="auto", metavar="NAME"
    )
    script: str | None = option("Strokes of the simulated grip, see docs/render.md.")
    seconds: float | None = option("End after this time; else with Ctrl-C.", metavar="S")
    virtual: bool = option("Run a script as fast as it can be computed.")
    log: Path | None = option("Record the session to this HDF5 file.")
    replay: Path | None = option("Render the motion of a recorded session.", metavar="LOG")
    bridge: str | None = option("Send positions to PORT by UDP, hear parameters on the next.", metavar="PORT")
    bridge_token: str | None = option(
        "What requests to the bridge must carry. [default: drawn, and printed]"
    )
    viewer: bool = option("Show the session in a browser; a mouse leads --device sim.")
    selftest: bool = option("Measure the servo on this machine, and leave.")
    yes: bool = option("Do not ask for consent: it was given.")
    twin: bool = option("Drive the program of a test machine on an emulated device, and fit what is felt.")
    felt: Path | None = option(
        "With --twin, what a test machine recorded at the grip of a real device.", metavar="RECORDING"
    )
    out: Path | None = option(
        "Where --twin writes. [default: twin, beside the BUNDLE]",
        type=click.Path(file_okay=False, path_type=Path), metavar="FOLDER",
    )
    # a blind comparison
    blind: bool = option("Compare without telling which is felt.")
    presentations: int | None = option("How many, evenly shared. [default: 10]", metavar="N")
    pseudonym: str | None = option("Letters and a number; never a name.", metavar="P17")
    key: Path | None = option("Where the answers go. [default: beside the log]")
    # fmt: on


@subcommand(
    "render",
    "bundle.h5",
    'bundle.h5 --device sim --script "indent 8 mm at 250 mm/min; hold 2 s" --log out.h5',
    '--preset paper-a --device sim --script "indent 4 mm at 250 mm/min" --virtual',
    'bundle.h5 --quantile 0.975 --of "force at 6 mm, 250 mm/min"',
    "a.h5 --against b.h5 --blind --log P17.h5",
    "bundle.h5 --replay out.h5",
    "--scene hip-resurfacing --plan patient.toml --device sim --viewer",
    "out/population.h5 --draw-specimen 7",
    "bundle.h5 --twin --against hold-8-1.csv",
    "bundle.h5 --device falcon --viewer --host 192.0.2.7",
    "                                 a tissue that comes along, moved by the mouse",
)
def command(flags: RenderFlags) -> int:
    """Feel the tissue of a BUNDLE.

    Without a BUNDLE, a tissue that comes along opens in a browser, moved by the mouse.
    Scale and stability are checked, and printed, before any force. No real device has confirmed this
    software: hardware starts at 2 N with the dead-man button on. Without a device, --device sim tries it all.
    """
    if flags.selftest:
        return _selftest(flags)
    if flags.twin:
        from tissueid.cli.twin_lines import twin

        return twin(flags)
    from tissueid.rendering.servo_spawn import spawn_servo

    flags = _demonstrated(flags)
    _must_belong(flags)
    # a servo's process loads while the plan is made; where no clock runs there is none
    waiting = nullcontext() if flags.virtual else closing(spawn_servo())
    if flags.viewer and flags.virtual:
        refuse("--virtual is over before it is seen: add --log FILE, then `tissueid view FILE`")
    with waiting as spawned, served(flags) if flags.viewer else nullcontext() as viewer:
        session = _prepared(flags, spawned, viewer)
        try:
            outcome = session.run()
        except DeviceError as error:
            raise _with_way_out(error, session.plan) from error
        finally:
            if session.bridge is not None:
                session.bridge.close()
    _report(flags, session.plan, outcome)
    codes = {5} if outcome.fault else set()
    if outcome.summary["recording_stopped"] is not None:
        codes.add(7)
    if outcome.interrupted and session.plan.seconds is not None:
        codes.add(130)
    return exit_code(codes) or (130 if 130 in codes else 0)


def _demonstrated(flags: RenderFlags) -> RenderFlags:
    """Nothing asked for: the first thing to see is a tissue that moves under the mouse, without motors."""
    tissue = ("bundle", "preset", "environment", "scene", "replay", "script", *_CHOICES)
    if flags.name == "auto" and not flags.virtual and all(getattr(flags, name) is None for name in tissue):
        return replace(flags, preset=DEMONSTRATED, name="sim", viewer=True)
    return flags


def _must_belong(flags: RenderFlags) -> None:
    """Refuse what would be passed over."""
    for whole, parts in _PARTS.items():
        for said in () if getattr(flags, whole) else typed(*parts):
            refuse(f"{said} is part of --{whole}: add --{whole}, or leave {said} out")
    if flags.replay is not None and flags.name not in {"auto", "replay"}:
        refuse("--replay moves in the place of a device: leave --device out")


def _prepared(flags: RenderFlags, spawned: SpawnedServo | None, viewer: ServedViewer | None) -> Session:
    """Everything that can be refused before a force."""
    from tissueid.rendering.bridge import UdpBridge, parse_address
    from tissueid.rendering.plan import plan_session
    from tissueid.rendering.recorder import Recorder
    from tissueid.rendering.session import Session

    options = _asked(flags)
    try:
        plan = plan_session(options)
    except DeviceError as error:
        if options.device in {"auto", "sim"}:
            raise
        raise _with_way_out(error, None) from error
    if flags.blind and flags.log is None:
        refuse("--blind is worth nothing without a record: add --log FILE")
    if viewer is not None:
        announce(viewer, flags)
    for line in plan.lines:
        note(line, quiet=flags.quiet)
    ask_for_consent(plan, given=flags.yes, quiet=flags.quiet)
    _write_key(flags, plan)
    bridge = None
    if flags.bridge is not None:
        bridge = UdpBridge(parse_address(flags.bridge), flags.bridge_token)
        if flags.bridge_token is None:
            note(f'bridge: requests must carry "token": "{bridge.token}"')

    def watch(servo: ServoProcess) -> None:
        if viewer is not None:
            from tissueid.viewer.hello import show_session

            show_session(viewer, plan, servo, flags.bundle)

    # last of all: what is refused after it would leave an empty log behind
    recorder = None if flags.log is None else Recorder(flags.log, plan.head)
    return Session(
        plan,
        recorder=recorder,
        bridge=bridge,
        ask=keyboard(switches=len(plan.blocks) > 1),
        show=telling_stop(viewer, recorder, status_line(plan, quiet=bool(flags.quiet or flags.as_json))),
        # a hand is needed: said however quiet
        tell=note,
        spawned=spawned,
        watch=watch,
    )


def _asked(flags: RenderFlags) -> RenderOptions:
    from tissueid.haptics.registry import configured
    from tissueid.rendering.options import RenderOptions

    scene = _scene(flags)
    if scene is not None and scene.device is not None and flags.name == "auto":
        flags = replace(flags, name=scene.device)
    asked = {key: getattr(flags, key) for key in _TISSUE} | {"tip_radius_mm": flags.tip_radius}
    # what is said on the command line comes before what the scene says
    said = {} if scene is None else {key: one for key, one in scene.tissue.items() if one is not None}
    said |= {key: value for key, value in asked.items() if value is not None}
    return RenderOptions(
        **{"surface": "plane", **said},
        **{key: getattr(flags, key) for key in _ALIKE},
        scene=scene,
        device=flags.name,
        # the device itself is made where it is used, in the servo's process
        device_options=configured(flags.name, asked_device(flags)),
        control=not flags.no_control,
        bridge=flags.bridge is not None,
        led=flags.viewer,
    )


def _scene(flags: RenderFlags) -> Scene | None:
    """The scene that was asked for; it brings its own tissue, or guidance in its place."""
    if flags.scene is None:
        if flags.plan is not None:
            refuse("--plan is an axis to be guided to: add --scene hip-resurfacing, or a scene of your own")
        return None
    from tissueid.rendering.scene import load_scene

    if flags.bundle is not None or flags.preset is not None or flags.environment is not None:
        refuse("--scene brings what is felt: leave bundle, --preset and --environment out")
    return load_scene(flags.scene, plan=flags.plan)


def _with_way_out(error: Any, plan: SessionPlan | None) -> Any:
    """A device's refusal, with what works without a device."""
    if "--device sim" in error.message or (plan is not None and not plan.capabilities.hardware):
        return error
    return DeviceError(f"{error.message.rstrip('.')}; without a device: --device sim")


def _write_key(flags: RenderFlags, plan: SessionPlan) -> None:
    """The answer key of a blind comparison, apart from the log."""
    from tissueid.rendering.session_plan import write_key

    if plan.order is None or flags.log is None:
        return
    path = flags.key or flags.log.with_suffix(".key.json")
    tissues = [
        {
            "tissue": number,
            "name": each.tissue.name,
            "bundle": str((flags.bundle, flags.against or flags.bundle)[number] or flags.preset),
            "draw": each.draw,
            "why": each.why,
        }
        for number, each in enumerate(plan.picked)
    ]
    write_key(path, plan.order, tissues)
    note(f"answer key in {path}; pseudonym {plan.order.pseudonym}", quiet=flags.quiet)


def _report(flags: RenderFlags, plan: SessionPlan, outcome: Outcome) -> None:
    if flags.as_json:
        echo_json(
            {
                "schema": "tissueid/render/1",
                "device": plan.head["device"],
                "scale": plan.head["scale"],
                "summary": outcome.summary,
                "log": None if outcome.log is None else str(outcome.log),
            }
        )
    if not flags.quiet:
        for line in summary_lines(outcome):
            note(line)
        return
    if outcome.fault:
        note(f"tissueid: {outcome.message}")
    stopped = outcome.summary["recording_stopped"]
    if stopped is not None:
        note(f"tissueid: recording stopped before the end: {stopped}")


def _selftest(flags: RenderFlags) -> int:
    from tissueid.rendering.selftest import DEFAULT_SECONDS, run_selftest

    seconds = flags.seconds or DEFAULT_SECONDS
    with progress_bar(show=not flags.quiet) as report:
        found = run_selftest(
            seconds,
            lambda share: report("the servo runs, nothing moves", round(share * seconds), round(seconds)),
        )
    if flags.as_json:
        figures = [{**asdict(figure), "holds": figure.holds} for figure in found.figures]
        timing = found.statistics.as_dict()
        echo_json(
            {"figures": figures, "timing": timing, "start_s": found.start_s, "remedies": found.remedies}
        )
        return 0
    for figure in found.figures:
        kept = "holds" if figure.holds else "NOT KEPT"
        echo(f"{figure.name:20} {figure.value:8.3g} {figure.unit}, bar {figure.bar:g}: {kept}")
    echo(f"{found.statistics.scheduling}, {found.statistics.missed} ticks skipped, {found.statistics.label}")
    echo(f"first tick after {found.start_s:.2f} s")
    for remedy in found.remedies:
        note(f"remedy: {remedy}", quiet=flags.quiet)
    return 0


#: Time between two status lines [s].
SHOW_EVERY_S = 0.1
#: Shares below this are not worth a word.
SMALLEST_SHARE = 5e-4


def ask_for_consent(plan: SessionPlan, *, given: bool, quiet: int) -> None:
    """Print what is to be agreed to, and ask; only motors and people need it."""
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
        refuse("consent is needed and nobody can be asked here; give --yes where it was given")
    click.confirm("Do you agree?", abort=True, err=True)


def keyboard(*, switches: bool) -> Callable[[], Wish]:
    """Wishes typed since the last call, never waited for: Enter is the next tissue, q and Enter the end."""
    from tissueid.rendering.session import Wish

    heard = sys.stdin is not None and sys.stdin.isatty()
    if heard:
        note("Enter: next tissue; q, Enter: end" if switches else "q, Enter: end")

    def ask() -> Wish:
        nonlocal heard
        if not heard or not select.select([sys.stdin], [], [], 0.0)[0]:
            return Wish()
        line = sys.stdin.readline()
        heard = bool(line)
        typed = line.strip().lower()
        return Wish(switch=heard and typed == "", stop=typed in {"q", "quit"})

    return ask


def status_line(plan: SessionPlan, *, quiet: bool) -> Callable[[Any, SessionSummary], None]:
    """One line that is written over and over, on a terminal only, unless it was written a moment ago."""
    from tissueid.haptics.states import Lamp, State

    on, shown_s = not quiet and sys.stderr.isatty(), 0.0

    def show(record: Any, summary: SessionSummary) -> None:
        nonlocal shown_s
        now = time.monotonic()
        if not on or now - shown_s < SHOW_EVERY_S:
            return
        shown_s = now
        which, tissue = "", f" (tissue {float(record['tissue_force_N']):.1f} N)"
        if plan.order is not None:
            which, tissue = f"presentation {int(record['label'])}  ", ""
        force = float((record["force_N"] ** 2).sum() ** 0.5)
        lamps = " ".join(str(lamp.name).lower().replace("_", " ") for lamp in Lamp(int(record["lamps"])))
        draw(
            f"\r\x1b[K{summary.seconds:7.1f} s  {State(int(record['state'])).name.lower():8} {which}"
            f"depth {float(record['depth_mm']):6.2f} mm  force {force:5.2f} N{tissue}  {lamps}"
        )

    return show


def summary_lines(outcome: Outcome) -> list[str]:
    """The session in a few lines."""
    from tissueid.documents import plain, typed
    from tissueid.documents.session import Summary

    summary = typed(plain(outcome.summary), Summary)
    period = summary.period_us
    ticks = f"{summary.ticks} ticks, {summary.skipped_ticks} skipped, {summary.lost_records} records lost"
    felt = f"{summary.peak_device_force_N:.3g} N at the device, {summary.peak_tissue_force_N:.4g} N of tissue"
    error = (
        f"median {period.median:.0f}, p99 {period.p99:.0f}, p99.9 {period.p99_9:.0f}, max {period.max:.0f}"
    )
    degraded = "; TIMING DEGRADED" if summary.timing_degraded else ""
    taken = f"{1e3 * summary.energy_J:.3g} mJ taken from the hand"
    text = [
        f"ended      {outcome.message}; {summary.seconds:.1f} s, {ticks}",
        f"peak       {felt}, {summary.deepest_mm:.3g} mm deep; {taken}",
        f"timing     {summary.scheduling}; period error {error} us{degraded}",
    ]
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
