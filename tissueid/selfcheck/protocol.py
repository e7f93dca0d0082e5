"""The protocol that is checked: what each log's tool did, and the tissue in the middle of the priors.

From a recipe its program behind an approach in air, from a bundle a ramp-and-hold program within what it was
identified on; recordings have their own measured x(t) (:mod:`tissueid.selfcheck.recorded`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import BundleError, InputError
from tissueid.model.channels import ChannelModel
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.selfcheck.recording import ProtocolLog
from tissueid.store.bundle import Bundle
from tissueid.synth.path import crosshead_path
from tissueid.synth.recipe import Hold, Log, Move, Recipe

#: Scatter of the contact points of a program without any [mm].
CONTACT_SD_MM = 0.01
#: A log that stays within so many of it is none.
GUARD_SD = 3.0
#: Approach in air before a program: at least so long [s], and so many samples.
AIR_S, AIR_SAMPLES = 1.0, 50
#: Program of a bundle whose recordings are gone: hold [s] at the least and most, in longest relaxation times.
SHORTEST_HOLD_S, LONGEST_HOLD_S, HOLD_TIMES = 5.0, 60.0, 10.0
#: Its sampling interval [s], in shortest relaxation times.
FINEST_STEP_S, COARSEST_STEP_S, STEP_TIMES = 1e-3, 1e-2, 0.5
SECONDS_PER_MINUTE = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class Centre:
    """The tissue that priors are centred on."""

    model: ChannelModel
    theta: FloatArray  # (p,)
    sigma_N: float
    phi: float  # correlation of the noise over one reference step; 0 is white
    white_share: float  # share of the noise's variance that is white beside a correlated part
    pooling: str  # ``scaled``, ``partial`` or ``shared``


@dataclass(frozen=True, slots=True, eq=False)
class Protocol:
    """Logs that are recorded of one specimen."""

    words: str  # its origin, in one sentence
    logs: tuple[ProtocolLog, ...]
    speeds_mm_s: tuple[float, float]  # slowest and fastest loading

    @property
    def depth_mm(self) -> float:
        """Largest depth."""
        return max(float(log.depth_mm.max()) for log in self.logs)

    @property
    def step_s(self) -> float:
        """Finest of the logs' median sampling intervals."""
        steps = [np.diff(log.time_s) for log in self.logs]
        return min(float(np.median(step[step > 0.0])) for step in steps)

    @property
    def duration_s(self) -> float:
        """Longest log, from contact on."""
        return max(float(log.time_s[-1]) for log in self.logs)

    @property
    def samples(self) -> int:
        """Samples in contact."""
        return sum(int((log.depth_mm > 0.0).sum()) for log in self.logs)


def in_air_first(
    name: str, time_s: FloatArray, depth_mm: FloatArray, *, speed_mm_s: float, contact_sd_mm: float
) -> ProtocolLog:
    """A log of a path that starts at contact, behind an approach in air at one speed.

    ``time_s``, ``depth_mm`` (n,): from contact on, both from 0; the first step is that of the approach.
    """
    step = float(time_s[1] - time_s[0])
    air = step * np.arange(-max(int(np.ceil(AIR_S / step)), AIR_SAMPLES), 0)
    return ProtocolLog(
        name, np.concatenate([air, time_s]), np.concatenate([air * speed_mm_s, depth_mm]), contact_sd_mm
    )


def of_program(
    logs: Sequence[Log],
    *,
    rate_Hz: float,
    contact_sd_mm: float,
    rounding_s: float = 0.0,
    words: str,
) -> Protocol:
    """The protocol of moves and holds that start at contact."""
    found: list[ProtocolLog] = []
    speeds = [move.speed_mm_s for log in logs for move in log.moves if isinstance(move, Move)]
    for log in logs:
        path = crosshead_path(log, rounding_s=rounding_s)
        time = np.arange(0.0, path.time_s[-1], 1.0 / rate_Hz)
        depth = path.at(time)
        if (depth >= GUARD_SD * contact_sd_mm).sum() < 2:
            message = f"log {log.name!r} of the program stays within its contact's standard deviation"
            raise InputError(code="recipe", message=message, path=words)
        first = next(move.speed_mm_s for move in log.moves if isinstance(move, Move))
        found += [
            in_air_first(
                f"{log.name}-{repeat + 1}", time, depth, speed_mm_s=first, contact_sd_mm=contact_sd_mm
            )
            for repeat in range(log.repeats)
        ]
    return Protocol(words=words, logs=tuple(found), speeds_mm_s=(min(speeds), max(speeds)))


def of_recipe(recipe: Recipe, *, rate_Hz: float | None = None) -> tuple[Protocol, Centre]:
    """Protocol and tissue of a synthetic recipe.

    Raises InputError: its tissue is none that the contact model has, or its noise has a negative correlation.
    """
    rate = rate_Hz or recipe.rate_Hz
    protocol = of_program(
        recipe.logs,
        rate_Hz=rate,
        contact_sd_mm=recipe.contact_offset_sd_mm or CONTACT_SD_MM,
        rounding_s=recipe.crosshead_rounding_s,
        words=f"the program of {recipe.name} at {rate:g} Hz",
    )
    degree = max((len(branch.stiffness) - 1 for branch in recipe.branches), default=0)
    if not recipe.branches:
        message = "its tissue has no branch: there is no relaxation to infer, add [[branches]]"
        raise InputError(code="recipe", message=message, path=recipe.name)
    if recipe.ar1_phi < 0.0:
        message = f"ar1_phi is {recipe.ar1_phi}; noise of negative correlation is not offered"
        raise InputError(code="recipe", message=message, path=recipe.name)
    try:
        model = kelvin_voigt(
            branches=len(recipe.branches), stiffness_degree=degree, depth_mm=protocol.depth_mm
        )
    except ValueError as error:
        raise InputError(code="recipe", message=str(error), path=recipe.name) from error
    stiffness = np.array(
        [(*branch.stiffness, *[0.0] * (degree + 1 - len(branch.stiffness))) for branch in recipe.branches]
    )
    tau = np.array([branch.tau_s for branch in recipe.branches])
    variance = recipe.sigma_N**2 + recipe.ar1_sigma_N**2
    if variance == 0.0:
        message = "its noise is zero: a posterior needs some, give sigma_N or ar1_sigma_N"
        raise InputError(code="recipe", message=message, path=recipe.name)
    correlated = recipe.ar1_sigma_N > 0.0 and recipe.ar1_phi > 0.0
    centre = Centre(
        model=model,
        theta=model.join(np.array(recipe.static), stiffness.reshape(len(recipe.branches), degree + 1), tau),
        sigma_N=float(np.sqrt(variance)),
        phi=recipe.ar1_phi if correlated else 0.0,
        white_share=recipe.sigma_N**2 / variance if correlated else 0.0,
        pooling=pooled("partial", logs=len(protocol.logs)),
    )
    return protocol, centre


def pooled(pooling: str, *, logs: int) -> str:
    """Way in which logs share F_s: one log has nothing to pool; bundles of before may say ``per-log``."""
    return "shared" if logs == 1 else {"per-log": "scaled"}.get(pooling, pooling)


def of_bundle(bundle: Bundle, *, where: str) -> tuple[Protocol, Centre]:
    """Tissue of a bundle, and a ramp-and-hold program within its depth and speeds.

    Raises BundleError: it holds no law, or a spectrum.
    """
    model = bundle.contact_model()
    if not bundle.parameters or model.fixed_s.size:
        msg = (
            f"{where}: {bundle.model.key} can't be checked: its times follow the recordings; fit another law"
        )
        raise BundleError(msg)
    tau = model.times(np.asarray(bundle.theta))
    slow, fast = bundle.speeds_mm_s
    slow, fast = (slow, fast) if fast > 0.0 else (1.0, 1.0)
    slow = slow if slow > 0.0 else fast
    longest, shortest = (float(tau.max()), float(tau.min())) if tau.size else (1.0, 1.0)
    hold_s = float(np.clip(HOLD_TIMES * longest, SHORTEST_HOLD_S, LONGEST_HOLD_S))
    step = float(np.clip(STEP_TIMES * shortest, FINEST_STEP_S, COARSEST_STEP_S))
    depth, middle = model.depth_mm, float(np.sqrt(slow * fast))
    ramps = [
        Log(f"ramp-{v:.3g}", (Move(depth, v * SECONDS_PER_MINUTE),)) for v in sorted({slow, middle, fast})
    ]
    holds = [
        Log(
            f"hold-{share * depth:.3g}",
            (Move(share * depth, fast * SECONDS_PER_MINUTE), Hold(hold_s)),
            repeats=2,
        )
        for share in (0.5, 1.0)
    ]
    protocol = of_program(
        [*ramps, *holds],
        rate_Hz=1.0 / step,
        contact_sd_mm=min(CONTACT_SD_MM, 1e-3 * depth),
        words=(
            f"a ramp-and-hold program within the bundle's depth ({depth:.3g} mm) and speeds "
            f"({slow:.3g} to {fast:.3g} mm/s), holds of {hold_s:.3g} s: its recordings are not there"
        ),
    )
    pooling = pooled(bundle.model.static_pooling, logs=len(protocol.logs))
    return protocol, Centre(
        model, np.asarray(bundle.theta), bundle.sigma_N, phi=0.0, white_share=0.0, pooling=pooling
    )
