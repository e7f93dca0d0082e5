"""``tissueid render``: feel an identified tissue on a device, or on the screen's simulated one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.completing import presets, scenes
from tissueid.cli.flags import argument, option, takes
from tissueid.cli.output import echo, echo_json, note
from tissueid.cli.viewer_serving import ViewerFlags, served, telling_stop

if TYPE_CHECKING:
    from tissueid.rendering.options import RenderOptions
    from tissueid.rendering.scene import Scene
    from tissueid.rendering.servo import ServoProcess
    from tissueid.rendering.servo_spawn import SpawnedServo
    from tissueid.rendering.session import Outcome, Session
    from tissueid.rendering.session_plan import SessionPlan
    from tissueid.viewer.serving import ServedViewer

EPILOG = """\b
Examples:
  tissueid render bundle.h5
  tissueid render bundle.h5 --device sim --script "indent 8 mm at 250 mm/min; hold 2 s" --log out.h5
  tissueid render --preset paper-a --device sim --script "indent 4 mm at 250 mm/min" --virtual
  tissueid render bundle.h5 --quantile 0.975 --of "force at 6 mm, 250 mm/min"
  tissueid render a.h5 --against b.h5 --blind --log P17.h5
  tissueid render bundle.h5 --replay out.h5
  tissueid render --scene hip-resurfacing --plan patient.toml --device sim --viewer
  tissueid render out/population.h5 --draw-specimen 7
  tissueid render bundle.h5 --twin --against hold-8-1.csv
  tissueid render bundle.h5 --device falcon --viewer --host 192.0.2.7
  tissueid render                                  a tissue that comes along, moved by the mouse
"""

#: Options that choose among the draws of bundles.
_CHOICES = ("draw", "draw_specimen", "quantile", "against", "against_draw", "against_quantile")
#: What is felt where nothing was asked for.
DEMONSTRATED = "paper-a"

_FILE = click.Path(dir_okay=False, path_type=Path)


#: Groups of options, each applied to the command in this order.
@dataclass(frozen=True, kw_only=True)
class _TissueFlags:
    """Flags of the tissue that is felt."""

    # fmt: off
    preset: str | None = option(
        "--preset", metavar="NAME", shell_complete=presets, help="A tissue that comes along: paper-a, meat.",
    )
    draw: int | None = option(
        "--draw", type=int, metavar="N", help="Feel posterior draw N instead of the fitted values.",
    )
    draw_specimen: str | None = option(
        "--draw-specimen", metavar="[SEED]", is_flag=False, flag_value="new",
        help="Feel a specimen drawn from a population.h5; without a seed another each time.",
    )
    quantile: float | None = option(
        "--quantile", type=float, metavar="Q", help="Feel the draw nearest this quantile of --of.",
    )
    of: str = option(
        "--of", metavar="TEXT", default="force at 6 mm, 250 mm/min", show_default=True,
        help="Which number the quantile, and the comparison of two tissues, is of.",
    )
    against: Path | None = option(
        "--against", type=_FILE, metavar="BUNDLE",
        help="A second tissue; Enter switches. With --twin, the recording whose travel is driven.",
    )
    against_draw: int | None = option("--against-draw", type=int, metavar="N", help="... of this draw.")
    against_quantile: float | None = option(
        "--against-quantile", type=float, metavar="Q", help="... of this quantile.",
    )
    environment: str | None = option(
        "--environment", metavar="NAME", help="An installed force law instead of a tissue.",
    )
    scene: str | None = option(
        "--scene", metavar="NAME|FILE", shell_complete=scenes,
        help="A scene.toml, or one that comes along: hip-resurfacing, meat, orbital-floor.",
    )
    plan: Path | None = option(
        "--plan", type=_FILE, metavar="FILE",
        help="Axis and entry point to be guided to, instead of the scene's.",
    )
    # fmt: on


@dataclass(frozen=True, kw_only=True)
class _ScaleFlags:
    """Flags of scale and surface."""

    # fmt: off
    force_scale: float | None = option(
        "--force-scale", type=float, metavar="S", help="Device force over tissue force.",
    )
    motion_scale: float | None = option(
        "--motion-scale", type=float, metavar="S", help="Device travel over tissue depth. [default: 5]",
    )
    surface: str | None = option(
        "--surface", metavar="TEXT",
        help="'plane', 'sphere R mm' or 'box X x Y x Z mm', in tissue units. [default: plane]",
    )
    tip_radius: float | None = option(
        "--tip-radius", type=click.FloatRange(min=0.0, min_open=True), metavar="MM",
        help="Radius of the tool tip; another than identified is refused.",
    )
    no_control: bool = option("--no-control", is_flag=True, help="The passivity controller only watches.")
    # fmt: on


@dataclass(frozen=True, kw_only=True)
class _SessionFlags:
    """Flags of the session."""

    # fmt: off
    name: str = option(
        "--device", default="auto", show_default=True, metavar="NAME",
        help="auto, sim, emulator, falcon, forcedimension, or an installed one.",
    )
    firmware: str | None = option(
        "--firmware", type=click.Path(), metavar="FILE", help="Firmware of a Falcon without any.",
    )
    port: str | None = option("--port", metavar="PATH", help="Serial port of a Falcon instead of USB.")
    calibration: str | None = option(
        "--calibration", type=click.Path(), metavar="FILE", help="Calibration of a Falcon.",
    )
    script: str | None = option(
        "--script", metavar="TEXT", help="Strokes of the simulated grip, see docs/render.md.",
    )
    seconds: float | None = option(
        "--seconds", type=float, metavar="S", help="End after this time; else with Ctrl-C.",
    )
    virtual: bool = option("--virtual", is_flag=True, help="Run a script as fast as it can be computed.")
    log: Path | None = option(
        "--log", type=_FILE, metavar="FILE", help="Record the session to this HDF5 file.",
    )
    replay: Path | None = option(
        "--replay", type=_FILE, metavar="LOG", help="Render the motion of a recorded session.",
    )
    bridge: str | None = option(
        "--bridge", metavar="PORT", help="Send positions to PORT by UDP, hear parameters on the next.",
    )
    bridge_token: str | None = option(
        "--bridge-token", metavar="TEXT",
        help="What requests to the bridge must carry. [default: drawn, and printed]",
    )
    viewer: bool = option(
        "--viewer", is_flag=True, help="Show the session in a browser; a mouse leads --device sim.",
    )
    selftest: bool = option("--selftest", is_flag=True, help="Measure the servo on this machine, and leave.")
    yes: bool = option("--yes", is_flag=True, help="Do not ask for consent: it was given.")
    twin: bool = option(
        "--twin", is_flag=True,
        help="Drive the program of a test machine on an emulated device, and fit what is felt.",
    )
    felt: Path | None = option(
        "--felt", type=_FILE, metavar="RECORDING",
        help="With --twin, what a test machine recorded at the grip of a real device.",
    )
    out: Path | None = option(
        "--out", type=click.Path(file_okay=False, path_type=Path), metavar="FOLDER",
        help="Where --twin writes. [default: twin, beside the BUNDLE]",
    )
    # fmt: on


@dataclass(frozen=True, kw_only=True)
class _BlindFlags:
    """Flags of a blind comparison."""

    # fmt: off
    blind: bool = option("--blind", is_flag=True, help="Compare without telling which is felt.")
    presentations: int | None = option(
        "--presentations", type=int, metavar="N", help="How many, evenly shared. [default: 10]",
    )
    pseudonym: str | None = option("--pseudonym", metavar="P17", help="Letters and a number; never a name.")
    key: Path | None = option(
        "--key", type=_FILE, metavar="FILE", help="Where the answers go. [default: beside the log]",
    )
    # fmt: on


@dataclass(frozen=True, kw_only=True)
class RenderFlags(_TissueFlags, _ScaleFlags, _SessionFlags, _BlindFlags, ViewerFlags):
    """Flags of ``tissueid render``."""

    # fmt: off
    bundle: Path | None = argument(required=False, type=_FILE)
    # fmt: on


@click.command("render", epilog=EPILOG)
@takes(RenderFlags)
def command(flags: RenderFlags) -> int:
    """Feel the tissue of a BUNDLE.

    Without a BUNDLE, a tissue that comes along opens in a browser, moved by the mouse.
    Scale and stability are checked, and printed, before any force. No real device has confirmed this
    software: hardware starts at 2 N with the dead-man button on. Without a device, --device sim tries it all.
    """
    from tissueid.errors import DeviceError, UsageError, exit_code

    if flags.selftest:
        return _selftest(flags)
    if flags.twin:
        from tissueid.cli.twin_lines import twin

        return twin(flags)
    if flags.felt is not None:
        msg = "--felt is what a test machine recorded at the grip: give --twin and a BUNDLE with it"
        raise UsageError(msg)
    flags = _demonstrated(flags)
    with _waiting_servo(flags) as spawned, _viewer(flags) as viewer:
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


@contextmanager
def _viewer(flags: RenderFlags) -> Iterator[ServedViewer | None]:
    """The viewer, where one is wanted."""
    from tissueid.errors import UsageError

    if not flags.viewer:
        yield None
        return
    if flags.virtual:
        msg = "--virtual is over before it is seen: add --log FILE, then `tissueid view FILE`"
        raise UsageError(msg)
    with served(flags) as viewer:
        yield viewer


@contextmanager
def _waiting_servo(flags: RenderFlags) -> Iterator[SpawnedServo | None]:
    """A servo's process that loads while the plan is made; none where no clock runs."""
    from tissueid.rendering.servo_spawn import spawn_servo

    if flags.virtual:
        yield None
        return
    with closing(spawn_servo()) as spawned:
        yield spawned


def _prepared(flags: RenderFlags, spawned: SpawnedServo | None, viewer: ServedViewer | None) -> Session:
    """Everything that can be refused before a force."""
    from tissueid.cli.render_screen import Keyboard, StatusLine, ask_for_consent
    from tissueid.errors import DeviceError, UsageError
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
    for line in plan.lines:
        note(line, quiet=flags.quiet)
    if flags.blind and flags.log is None:
        msg = "--blind is worth nothing without a record: add --log FILE"
        raise UsageError(msg)
    ask_for_consent(plan, given=flags.yes, quiet=flags.quiet)
    _write_key(flags, plan)
    bridge = None
    if flags.bridge is not None:
        bridge = UdpBridge(parse_address(flags.bridge), flags.bridge_token)
        if flags.bridge_token is None:
            note(f'bridge: requests must carry "token": "{bridge.token}"')
    # last of all: what is refused after it would leave an empty log behind
    recorder = None if flags.log is None else Recorder(flags.log, plan.head)
    return Session(
        plan,
        recorder=recorder,
        bridge=bridge,
        ask=Keyboard(switches=len(plan.blocks) > 1),
        show=telling_stop(viewer, recorder, StatusLine(plan, quiet=bool(flags.quiet or flags.as_json))),
        # a hand is needed: said however quiet
        tell=note,
        spawned=spawned,
        watch=lambda servo: _show(viewer, plan, servo, flags.bundle),
    )


def _show(viewer: ServedViewer | None, plan: SessionPlan, servo: ServoProcess, bundle: Path | None) -> None:
    """Show a servo on the viewer, where there is one."""
    if viewer is not None:
        from tissueid.viewer.showing import show_session

        show_session(viewer, plan, servo, bundle)


def _asked(flags: RenderFlags) -> RenderOptions:
    from tissueid.rendering.options import RenderOptions

    scene = _scene(flags)
    if scene is not None and scene.device is not None and flags.name == "auto":
        flags = replace(flags, name=scene.device)
    asked: dict[str, Any] = {
        "bundle": flags.bundle,
        "preset": flags.preset,
        "force_scale": flags.force_scale,
        "motion_scale": flags.motion_scale,
        "tip_radius_mm": flags.tip_radius,
        "surface": flags.surface,
    }
    if scene is not None:
        # what is said on the command line comes before what the scene says
        asked = {**scene.tissue, **{key: value for key, value in asked.items() if value is not None}}
    given: dict[str, Any] = {key: value for key, value in asked.items() if value is not None}
    return RenderOptions(
        **{"surface": "plane", **given},
        scene=scene,
        draw=flags.draw,
        draw_specimen=flags.draw_specimen,
        quantile=flags.quantile,
        of=flags.of,
        against=flags.against,
        against_draw=flags.against_draw,
        against_quantile=flags.against_quantile,
        device=flags.name,
        device_options=_device_options(flags),
        script=flags.script,
        seconds=flags.seconds,
        environment=flags.environment,
        control=not flags.no_control,
        blind=flags.blind,
        presentations=flags.presentations,
        pseudonym=flags.pseudonym,
        replay=flags.replay,
        virtual=flags.virtual,
        bridge=flags.bridge is not None,
        led=flags.viewer,
    )


def _scene(flags: RenderFlags) -> Scene | None:
    """The scene that was asked for; it brings its own tissue, or guidance in its place."""
    from tissueid.errors import UsageError

    if flags.scene is None:
        if flags.plan is not None:
            msg = "--plan is an axis to be guided to: add --scene hip-resurfacing, or a scene of your own"
            raise UsageError(msg)
        return None
    from tissueid.rendering.scene import load_scene

    if flags.bundle is not None or flags.preset is not None or flags.environment is not None:
        msg = "--scene brings what is felt: leave bundle, --preset and --environment out"
        raise UsageError(msg)
    return load_scene(flags.scene, plan=flags.plan)


def _device_options(flags: RenderFlags) -> dict[str, Any]:
    """Options of a driver; the device itself is made where it is used, in the servo's process."""
    from tissueid.cli.device_opening import asked_device
    from tissueid.haptics.registry import configured

    return configured(flags.name, asked_device(flags))


def _with_way_out(error: Any, plan: SessionPlan | None) -> Any:
    """A device's refusal, with what works without a device."""
    from tissueid.errors import DeviceError

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
    """The session in numbers."""
    from tissueid.cli.render_screen import summary_lines

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
    """Figures of the servo on this machine."""
    from dataclasses import asdict

    from tissueid.cli.output import progress_bar
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
