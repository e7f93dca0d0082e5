"""Information of every indentation that is looked at, kept; the precision of a protocol from their sum."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.design.information import Chain, Indentation, information, peak_force, seconds_of
from tissueid.design.tissues import Tissues, Want

#: Depths at which the greatest allowed one is looked for.
DEPTH_GRID = 400
#: Forces are kept below the limit by so many standard deviations of the gain.
GAIN_MARGIN = 3.0
#: Ridge, relative to the scaled diagonal, for directions that a protocol does not determine.
RIDGE = 1e-13

Protocol = Mapping[Indentation, int]


@dataclass(frozen=True, slots=True)
class Asked:
    """Wants and limits of the user."""

    wants: tuple[Want, ...]
    max_depth_mm: float
    max_force_N: float  # the lesser of the user's and the load cell's
    budget_s: float = 8.0 * 3600.0  # machine time a specimen
    recovery_s: float = 60.0  # rest between logs
    setup_s: float = 600.0  # mounting and zeroing of a specimen
    repeats: int = 3  # least repeats of every indentation
    max_logs: int = 60  # most logs of a specimen
    assurance: float = 0.9  # share of the tissues for which a precision must be reached
    gain_sd: float = 0.02  # scatter of the gain from log to log
    total: bool = False  # calibration nuisances count


@dataclass(frozen=True, slots=True, eq=False)
class Precision:
    """Relative standard deviations of a protocol."""

    sd: FloatArray  # (wants, draws)
    wants: tuple[Want, ...]
    assurance: float

    @property
    def assured(self) -> FloatArray:
        """For each want, what the share ``assurance`` of the tissues has or betters."""
        return np.quantile(self.sd, self.assurance, axis=1, method="higher")

    @property
    def median(self) -> FloatArray:
        """For each want, over the tissues."""
        return np.asarray(np.median(self.sd, axis=1))

    @property
    def worst(self) -> float:
        """Largest ratio of assured to wanted; at most 1 where all wants are met."""
        return float((self.assured / np.array([want.share for want in self.wants])).max())


@dataclass(slots=True, eq=False)
class Ledger:
    """Indentations of one machine and setting on some tissues, each computed once."""

    tissues: Tissues
    chain: Chain
    asked: Asked
    tick: Callable[[], None] = lambda: None  # called with every path that is simulated
    computed: int = 0
    _slopes: FloatArray | None = None
    _known: dict[Indentation, FloatArray] = field(default_factory=dict)
    _depths: dict[float, float] = field(default_factory=dict)

    def deepest(self, speed_mm_min: float) -> float:
        """Depth [mm] that a ramp may reach without passing the greatest force on any tissue."""
        if speed_mm_min not in self._depths:
            grid = np.linspace(0.0, self.asked.max_depth_mm, DEPTH_GRID + 1)[1:]
            limit = self.asked.max_force_N * np.exp(-GAIN_MARGIN * self.asked.gain_sd)
            model = self.tissues.model
            most = [peak_force(model, one, speed_mm_min / 60.0, grid) for one in self.tissues.theta]
            allowed = (np.stack(most) <= limit).all(axis=0)
            self._depths[speed_mm_min] = float(grid[allowed][-1]) if allowed.any() else 0.0
        return self._depths[speed_mm_min]

    def peak_N(self, test: Indentation) -> float:
        """Greatest force on any tissue."""
        grid = np.linspace(0.0, test.depth_mm, DEPTH_GRID + 1)[1:]
        model = self.tissues.model
        return float(max(peak_force(model, one, test.speed_mm_s, grid)[-1] for one in self.tissues.theta))

    def seconds(self, test: Indentation) -> float:
        """Machine time of one log, with the rest that follows it."""
        return seconds_of(test, self.chain.machine) + self.asked.recovery_s

    def learn(self, speed_mm_min: float, depth_mm: float, holds_s: Sequence[float]) -> None:
        """Compute an indentation for several holds in one pass."""
        tests = [Indentation(speed_mm_min, depth_mm, hold) for hold in sorted(holds_s)]
        if all(test in self._known for test in tests):
            return
        holds = [test.hold_s for test in tests]
        model, theta = self.tissues.model, self.tissues.theta
        found = np.stack([information(model, one, tests[0], self.chain, holds) for one in theta], axis=1)
        self.computed += theta.shape[0]
        self.tick()
        self._known |= dict(zip(tests, found, strict=True))

    def information(self, test: Indentation) -> FloatArray:
        """Information of one log, shape (draws, q, q)."""
        self.learn(test.speed_mm_min, test.depth_mm, [test.hold_s])
        return self._known[test]

    def gradients(self) -> FloatArray:
        """Of the logarithm of every wanted number, shape (wants, draws, q)."""
        if self._slopes is None:
            out = np.stack([self.tissues.gradients(want.name) for want in self.asked.wants])
            self._slopes = np.pad(out, ((0, 0), (0, 0), (0, self.chain.nuisances)))
        return self._slopes

    def total(self, protocol: Protocol) -> FloatArray:
        """Information of a protocol with the priors of the calibration, shape (draws, q, q)."""
        sums = sum(count * self.information(test) for test, count in protocol.items() if count)
        return np.asarray(sums + self.chain.prior(self.tissues.theta.shape[1]))

    def precision(self, protocol: Protocol) -> Precision:
        """Relative standard deviations of the wanted numbers."""
        sd = relative_sd(self.total(protocol), self.gradients())
        return Precision(sd, self.asked.wants, self.asked.assurance)

    def duration(self, protocol: Protocol) -> float:
        """Machine time of a specimen: mounting, logs, and rests between them."""
        logs = sum(count * self.seconds(test) for test, count in protocol.items())
        return self.asked.setup_s + logs - self.asked.recovery_s


def relative_sd(matrix: FloatArray, gradients: FloatArray) -> FloatArray:
    """sqrt(g' M^-1 g) of information matrices (..., q, q) and gradients (wants, draws, q).

    The draws are the last of the matrices' leading axes; a direction without information has an infinite one.
    """
    diagonal = np.einsum("...ii->...i", matrix)
    unit = 1.0 / np.sqrt(np.maximum(diagonal, 1e-300))
    scaled = matrix * unit[..., :, None] * unit[..., None, :] + RIDGE * np.eye(matrix.shape[-1])
    sides = np.moveaxis(gradients, 0, -1) * unit[..., :, None]
    solved = np.linalg.solve(scaled, sides)
    variance = np.moveaxis((sides * solved).sum(axis=-2), -1, 0)
    return np.sqrt(np.where(variance >= 0.0, variance, np.inf))
