"""A damped static law as the engine sees it: static columns times 1 + chi r, r measured along the path.

Beside them every log has its reading in air, a constant force: where nothing relaxes, the ratio of two forces
is all that tells the damping, and a reading that is off by 0.3 % of the force is off by as much in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.inference.channel_law import ChannelLaw
from tissueid.inference.law import Path, Slopes
from tissueid.model.channels import ChannelModel
from tissueid.model.damped import DampedModel


@dataclass(frozen=True)
class DampedLaw(ChannelLaw):
    """Static law with a damping parameter in the place of an inside channel's ratio."""

    logs: int = 1  # of the specimen
    only: tuple[int, ...] | None = None  # the logs that a path of some of them is of

    @cached_property
    def linear(self) -> int:
        """Static coefficients, and the reading in air of each log."""
        return self.static_size + self.logs

    def _damped(self, log_times: FloatArray, path: Path) -> FloatArray:
        """Factor on the static force, (m,) or (n, m)."""
        assert isinstance(self.model_of, DampedModel)  # noqa: S101 -- it is made from one
        factor = self.model_of.damping.factor(self._of_branch(self._values(log_times), 0)[0])
        return np.asarray(np.maximum(1.0 + factor * path.speed_ratio, 0.0))

    def columns(self, log_times: FloatArray, path: Path) -> FloatArray:
        """Columns along a path, shape (linear, m) or (linear, n, m)."""
        out = np.zeros((self.linear, *path.depth_mm.shape))
        self._static_columns(path, self._values(log_times), out)
        out[: self.static_size] *= self._damped(log_times, path)
        ends = np.append(path.fresh[1:], path.step_s.size)
        numbers = range(self.logs) if self.only is None else self.only
        for number, first, last in zip(numbers, path.fresh, ends, strict=True):
            out[self.static_size + number, ..., first:last] = 1.0
        return out

    def slopes(self, log_times: FloatArray, path: Path, linear: FloatArray) -> Slopes:
        """F_s' (1 + chi r); what a frame gives way to changes the depth, not the measured speed."""
        shapes = self._of_static(self._values(log_times))
        full = self._full(shapes)
        slope = self.static.slope(path.depth_mm, *shapes) * self.depth_mm / full.reshape(len(full), 1)
        direct = (linear[: self.static_size] @ slope) * self._damped(log_times, path)
        return Slopes(np.asarray(direct), np.zeros((1, direct.size)), np.ones(1))

    def theta(self, log_times: FloatArray, linear: FloatArray, *, exact: bool = False) -> FloatArray:
        """Theta of the contact model, of one point or of rows of points; readings in air are none of it."""
        return super().theta(log_times, linear[..., : self.static_size], exact=exact)

    def along(self, logs: tuple[int, ...]) -> DampedLaw:
        """The same law for a path of some logs."""
        return replace(self, only=logs)


def law_of(model: ChannelModel, logs: int) -> ChannelLaw:
    """The law of a model, as the engine fits it to a number of logs."""
    if isinstance(model, DampedModel):
        return DampedLaw(model.static, 0, model.relaxation, 1, model.depth_mm, model, logs)
    return ChannelLaw.of(model)
