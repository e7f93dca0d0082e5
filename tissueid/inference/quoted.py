"""The numbers people quote from a fit, each within what its data support.

Nothing is said of times after the longest hold or before two sampling intervals, nor of frequencies
outside the reciprocal band 1/(2 pi window) ... 1/(2 pi resolution); a number whose 95 % interval is as
wide as the number is not given.  Each such place holds the reason instead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.documents.quantities import Spectrum
from tissueid.inference.choice import Rival
from tissueid.inference.estimates import MAX_WIDTH, TissueEstimate, width_of
from tissueid.inference.holds import HoldNumbers
from tissueid.measured import TIMES_S
from tissueid.model import functionals
from tissueid.model.channels import ChannelModel
from tissueid.quantities import Quantity, QuotedNumbers

#: Frequencies at which moduli are quoted where the data support them [Hz].
FREQUENCIES_HZ = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
#: Depths of stiffness, and mean and amplitude of a cycle, as shares of the fitted depth.
STIFFNESS_SHARES = (0.5, 1.0)
CYCLE_DEPTH, CYCLE_AMPLITUDE = 0.5, 0.1
#: Widest 95 % interval of a fraction that is quoted.
MAX_FRACTION_WIDTH = 0.5
#: A plateau is seen where the window holds so many of the slowest relaxation time.
PLATEAU_TIMES = 3.0
TWO_SIDED_95 = 1.96
#: Least uncertainty by the form of the law, of the peak, where another law predicts as well.
LEAST_FORM = 0.02
#: Holds at least this share of the longest count as equally long.
EQUALLY_LONG = 0.99


@dataclass(frozen=True, slots=True)
class Supported:
    """Coverage of a specimen's recordings."""

    #: Longest hold (longest log without one), and two sampling intervals.
    window_s: float
    resolution_s: float
    hold: HoldNumbers  # with the speed and depth of the ramp before the longest hold

    def no_time(self, time_s: float) -> str:
        """Reason that nothing can be said of a time; empty where something can."""
        if time_s > self.window_s:
            return f"later than the {self.window_s:.4g} s that were seen"
        if time_s < self.resolution_s:
            return f"earlier than two sampling intervals, {self.resolution_s:.3g} s"
        return ""

    def no_frequency(self, frequency_Hz: float) -> str:
        """Reason that nothing can be said of a frequency; empty where something can."""
        low, high = 1.0 / (2.0 * np.pi * self.window_s), 1.0 / (2.0 * np.pi * self.resolution_s)
        if low <= frequency_Hz <= high:
            return ""
        return f"outside {low:.3g} to {high:.3g} Hz, which these times cover"


def unknown_parameters(tissue: TissueEstimate) -> NDArray[np.bool_]:
    """Parameters of theta whose variance is infinite, shape (p,)."""
    known = {one.name: one for one in tissue.parameters}
    return np.array(
        [
            known[name].detail["estimate_stderr"] is None and not known[name].detail["at_bound"]
            for name in tissue.model.parameter_names
        ],
        dtype=np.bool_,
    )


@dataclass(frozen=True, slots=True)
class _Quoter:
    """Turns functions of theta into quantities with errors and verdicts."""

    tissue: TissueEstimate
    unknown: NDArray[np.bool_]

    def __call__(
        self,
        name: str,
        unit: str,
        at: dict[str, float | str],
        function: Callable[[ChannelModel, FloatArray], float],
        reason: str = "",
    ) -> Quantity:
        if reason:
            return Quantity(name, unit, at, None, None, reason)
        tissue = self.tissue
        value, stderr = functionals.delta_method(
            lambda theta: function(tissue.model, theta), tissue.theta, tissue.covariance, self.unknown
        )
        fraction = name.startswith("fraction")
        width = 2.0 * TWO_SIDED_95 * stderr if fraction else width_of(abs(value), stderr)
        if not np.isfinite(value):
            return Quantity(name, unit, at, None, None, "no finite value")
        if not width <= (MAX_FRACTION_WIDTH if fraction else MAX_WIDTH):
            return Quantity(name, unit, at, None, None, "the data do not determine it")
        return Quantity(name, unit, at, value, stderr)


def _relaxation(quote: _Quoter, supported: Supported) -> Iterator[Quantity]:
    """Fraction relaxed after an ideal step and after the ramp of the longest hold."""
    model, hold = quote.tissue.model, supported.hold
    depth = hold.depth_mm or model.depth_mm
    slowest = float(model.times(quote.tissue.theta).max(initial=0.0))
    flat = (
        ""
        if slowest * PLATEAU_TIMES <= supported.window_s
        else f"its plateau was not seen: a relaxation time of {slowest:.3g} s in {supported.window_s:.3g} s"
    )
    no_ramp = "" if hold.longest_s > 0.0 and hold.speed_mm_s > 0.0 else "no ramp with a hold was recorded"

    def step(model: ChannelModel, theta: FloatArray, time: float) -> float:
        return functionals.force_after_step(model, theta, depth, time)

    def ramp(model: ChannelModel, theta: FloatArray, time: float) -> float:
        return functionals.force_after_ramp(model, theta, depth, hold.speed_mm_s, time)

    for path, force, reason in (("step", step, ""), ("ramp", ramp, no_ramp)):
        at: dict[str, float | str] = {"path": path, "depth_mm": depth}
        if path == "ramp" and not reason:
            at["speed_mm_s"] = hold.speed_mm_s
        for time in TIMES_S:

            def relaxed(m: ChannelModel, t: FloatArray, force=force, time=time) -> float:  # type: ignore[no-untyped-def]
                return float(1.0 - force(m, t, time) / force(m, t, 0.0))

            why = reason or supported.no_time(time)
            yield quote("fraction_relaxed", "1", {**at, "time_s": time}, relaxed, why)

        def ratio(m: ChannelModel, t: FloatArray, force=force) -> float:  # type: ignore[no-untyped-def]
            rest = float(m.static_force(t, np.array([depth]))[0])
            return float(force(m, t, 0.0)) / rest if rest > 0.0 else float("inf")

        yield quote("peak_to_plateau", "1", at, ratio, reason or flat)


def _oscillation(quote: _Quoter, supported: Supported, frequencies: Sequence[float]) -> Iterator[Quantity]:
    """Storage, loss, tan(delta) and energy of a cycle about half depth."""
    full = quote.tissue.model.depth_mm
    depth, amplitude = CYCLE_DEPTH * full, CYCLE_AMPLITUDE * full
    for f in frequencies or FREQUENCIES_HZ:
        why = supported.no_frequency(f)
        if why and not frequencies:
            continue
        at: dict[str, float | str] = {"frequency_Hz": f, "depth_mm": depth}

        def storage(m: ChannelModel, t: FloatArray, f: float = f) -> float:
            return functionals.complex_stiffness(m, t, depth, f)[0]

        def loss(m: ChannelModel, t: FloatArray, f: float = f) -> float:
            return functionals.complex_stiffness(m, t, depth, f)[1]

        def tangent(m: ChannelModel, t: FloatArray, f: float = f) -> float:
            return loss(m, t, f) / storage(m, t, f)

        def energy(m: ChannelModel, t: FloatArray, f: float = f) -> float:
            return functionals.dissipated_per_cycle(m, t, depth, amplitude, f)

        yield quote("storage_stiffness", "N/mm", at, storage, why)
        yield quote("loss_stiffness", "N/mm", at, loss, why)
        yield quote("tan_delta", "1", at, tangent, why)
        yield quote("dissipated_energy", "mJ", {**at, "amplitude_mm": amplitude}, energy, why)


def _stiffness(quote: _Quoter) -> Iterator[Quantity]:
    """Instantaneous and equilibrium stiffness at half and full depth."""
    kinds = (
        ("equilibrium", functionals.equilibrium_stiffness),
        ("instantaneous", functionals.instantaneous_stiffness),
    )
    for share in STIFFNESS_SHARES:
        depth = share * quote.tissue.model.depth_mm
        for word, function in kinds:
            for which, form in enumerate(("secant", "tangent")):

                def value(m: ChannelModel, t: FloatArray, f=function, d=depth, w=which) -> float:  # type: ignore[no-untyped-def]
                    return float(f(m, t, d)[w])

                yield quote(f"{word}_{form}", "N/mm", {"depth_mm": depth}, value)


def model_numbers(
    tissue: TissueEstimate, supported: Supported, frequencies_Hz: Sequence[float] = ()
) -> tuple[Quantity, ...]:
    """Functionals of a fitted tissue.

    ``frequencies_Hz``: asked for: those that are not supported come with the reason.  Without any, the
    supported of :data:`FREQUENCIES_HZ`.
    """
    quote = _Quoter(tissue, unknown_parameters(tissue))
    return (
        *_relaxation(quote, supported),
        *_oscillation(quote, supported, frequencies_Hz),
        *_stiffness(quote),
    )


def with_form(numbers: QuotedNumbers, rivals: Sequence[Rival]) -> QuotedNumbers:
    """The same numbers, shares that relax with the spread over laws that predict as well.

    Half the range over the laws, at least :data:`LEAST_FORM` of the peak, is added in quadrature.
    """
    alike = [one for one in rivals if one.as_good]
    if not alike:
        return numbers
    rows = []
    for one in numbers.model:
        if one.name != "fraction_relaxed" or one.value is None or one.stderr is None:
            rows.append(one)
            continue
        depth, time = float(one.at["depth_mm"]), float(one.at["time_s"])
        speed = float(one.at["speed_mm_s"]) if "speed_mm_s" in one.at else None
        values = [one.value, *(_share(rival, depth, speed, time) for rival in alike)]
        form = max(0.5 * float(np.ptp(values)), LEAST_FORM)
        rows.append(replace(one, stderr=float(np.hypot(one.stderr, form))))
    return replace(numbers, model=tuple(rows))


def _share(rival: Rival, depth: float, speed: float | None, time: float) -> float:
    """Share of the peak that a rival's tissue loses."""
    model, theta = rival.model, rival.theta
    still = float(model.static_force(theta, np.array([depth]))[0])
    peak, later = still + model.relaxing(theta, depth, np.array([0.0, time]), speed)
    return float(1.0 - later / peak)


def quoted_numbers(
    tissue: TissueEstimate,
    holds: Sequence[HoldNumbers],
    *,
    step_s: float,
    duration_s: float,
    frequencies_Hz: Sequence[float] = (),
) -> QuotedNumbers:
    """Functionals and spectra of one specimen; moduli are added by whoever knows a tip.

    ``holds``: a trial each; ``step_s``, ``duration_s``: sampling interval and longest fitted log [s].
    """
    most = max((one.longest_s for one in holds), default=0.0)
    # of holds equally long the deepest: the same protocol ends a sample earlier or later
    equal = [one for one in holds if one.longest_s >= EQUALLY_LONG * most]
    longest = max(equal, key=lambda one: one.depth_mm, default=HoldNumbers())
    window = longest.longest_s or duration_s
    supported = Supported(window_s=window, resolution_s=2.0 * step_s, hold=longest)
    spectra: tuple[Spectrum, ...] = tuple(one for hold in holds for one in hold.spectra)
    return QuotedNumbers(
        window_s=window,
        resolution_s=2.0 * step_s,
        model=model_numbers(tissue, supported, frequencies_Hz),
        spectra=spectra,
    )
