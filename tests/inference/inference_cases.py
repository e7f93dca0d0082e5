"""Specimens with a known truth for the tests of inference: the segmenter's part is played by the truth."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tissueid.inference.blocks import Blocks, log_blocks
from tissueid.inference.channel_law import ChannelLaw
from tissueid.inference.engine import Identified, Request
from tissueid.inference.logs import LogHandle
from tissueid.inference.specimen import FitOptions, FittedSpecimen, fit_with_state, identify_handles
from tissueid.inference.system import Effects, Point, System
from tissueid.inference.trials import Adjustment
from tissueid.inference.window import FittedLog, LogData, fitted_log
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.priors import Priors
from tissueid.segment import segment
from tissueid.synth import Hold, Log, Move, Recipe, SyntheticLog, as_trials, simulate
from tissueid.trial import Contact, Phase, Segmentation, Trial

#: Standard deviation of a contact point that is known: small against every depth used here.
KNOWN_CONTACT_MM = 1e-4


def log_data(time_s, depth_mm, force_N, *, include=None, fold=None) -> LogData:
    """A log in the contact frame; everything included, one fold, unless said."""
    n = len(time_s)
    return LogData(
        time_s=np.ascontiguousarray(time_s, dtype=float),
        depth_mm=np.ascontiguousarray(depth_mm, dtype=float),
        force_N=np.ascontiguousarray(force_N, dtype=float),
        include=np.ones(n, dtype=bool) if include is None else np.asarray(include, dtype=bool),
        fold=np.zeros(n, dtype=np.int64) if fold is None else np.asarray(fold, dtype=np.int64),
    )


def blocks_from(data: LogData, *, whole: bool = False) -> Blocks:
    """Blocks of a log that starts in contact."""
    step = float(np.median(np.diff(data.time_s)))
    return log_blocks(data, step_s=step, contact_sd_mm=0.02, leads=False, whole=whole)


def ramp_hold(rate_Hz: float, speed_mm_s: float, depth_mm: float, hold_s: float):
    """Times and depths of a ramp from contact and a hold, the corner on a sample."""
    time = np.arange(round((depth_mm / speed_mm_s + hold_s) * rate_Hz) + 1) / rate_Hz
    return time, np.minimum(speed_mm_s * time, depth_mm)


def point_of(law: ChannelLaw, theta, *, logs: int = 1, own: int = 1, machine=(0.0, 0.0, 0.0)) -> Point:
    """Theta [N, mm, s] as a point of the law, the logs without anything of their own."""
    static, stiffness, tau = law.model().split(np.asarray(theta, dtype=float))
    linear = [static * law.depth_mm ** np.arange(1.0, 4.0)]
    linear += [row * law.depth_mm ** np.arange(1.0, law.degree + 2.0) for row in stiffness]
    return Point(np.log(tau), np.array(machine), np.concatenate(linear), np.zeros((logs, own)))


def system_of(
    logs: Sequence[LogData], law: ChannelLaw, *, effects: Effects | None = None, whole: bool = False
) -> System:
    """Logs that start in contact under a law."""
    blocks = [blocks_from(one, whole=whole) for one in logs]
    return System(blocks, law, law.depth_mm, effects or Effects())


def model_force(model: ChannelModel, theta, log: FittedLog, adjustment: Adjustment):
    """Force of the contact model along a log, by the model's own recursion."""
    x = log.data.depth_mm - adjustment.contact_offset_mm
    return adjustment.gain * model.force(theta, ContactPath(log.data.time_s, np.maximum(x, 0.0)))


def true_segmentation(trial: Trial, *, sd_mm: float = KNOWN_CONTACT_MM, noise_N: float = 0.0) -> Segmentation:
    """Ramp, and hold where there is one, from the protocol; contact at the first sample and at zero."""
    time, n = trial.time_s, trial.time_s.size
    speed, depth = trial.protocol.speed_mm_s, trial.protocol.depth_mm
    corner = min(int(np.searchsorted(time, depth / speed - 1e-9)), n - 1)
    ramp = Phase("ramp", 0, corner + 1, float(time[0]), float(time[corner]), speed)
    phases = (ramp, Phase("hold", corner, n, float(time[corner]), float(time[-1]), 0.0))
    if corner >= n - 2:
        phases = (replace(ramp, stop=n, end_s=float(time[-1])),)
    return Segmentation(1, 1, Contact(0, 0.0, sd_mm), phases, noise_N)


def handle_for(trial: Trial, segmentation: Segmentation) -> LogHandle:
    facts = fitted_log(trial, segmentation)
    return LogHandle(
        load=lambda: trial,
        segmentation=segmentation,
        facts=facts.without_samples(),
        contact_sd_mm=facts.contact_sd_mm,
    )


def handles_for(logs: Sequence[SyntheticLog], *, sd_mm: float = KNOWN_CONTACT_MM) -> list[LogHandle]:
    return [handle_for(trial, true_segmentation(trial, sd_mm=sd_mm)) for trial in as_trials(list(logs))]


def handles_of(recipe: Recipe, seed: int, *, sd_mm: float = KNOWN_CONTACT_MM) -> list[LogHandle]:
    return handles_for(draw(recipe, seed), sd_mm=sd_mm)


def identified(
    handles: Sequence[LogHandle],
    *,
    branches: tuple[int, ...] = (1,),
    degrees: tuple[int, ...] = (0,),
    pooling: str = "shared",
    noise: str = "auto",
    machine: bool = False,
    **more,
) -> Identified:
    """The optimum of some logs."""
    request = Request(branches, degrees, pooling, noise, machine=machine, **more)
    return identify_handles(list(handles), request, lambda _: None)[0]


def small_recipe(**changes) -> Recipe:
    """Three ramps and two short holds of one soft specimen: a few thousand samples at 100 Hz."""
    ramps = tuple(Log(f"ramp-{v:03.0f}", (Move(4.0, v),)) for v in (60.0, 240.0, 600.0))
    holds = tuple(Log(f"hold-{d:.0f}", (Move(d, 240.0), Hold(3.0))) for d in (2.0, 4.0))
    return replace(Recipe("small", ramps + holds, rate_Hz=100.0, sigma_N=0.2), **changes)


def draw(recipe: Recipe, seed: int) -> list[SyntheticLog]:
    return simulate(recipe, rng=np.random.default_rng(seed))


def divided_handle(trial: Trial) -> LogHandle:
    """The handle that the pipeline would hand to the fit, divided by the segmenter."""
    return handle_for(trial, segment(trial))


def state_of(
    handles: Sequence[LogHandle], *, machine: bool = False, priors: Priors | None = None, tick=None, **options
) -> FittedSpecimen:
    """A specimen's fit with one branch of constant K, unless asked; nothing is unknown of the machine."""
    chosen = FitOptions(**{"branches": 1, "stiffness_degree": 0, **options})
    return fit_with_state("knee", handles, options=chosen, machine=machine, priors=priors, tick=tick)


def by_name(fit) -> dict:
    return {one.name: one for one in fit.parameters}
