"""The numbers people quote from a fit, each within what its data support, or the reason instead.

Under a known tip, moduli by every formula that fits it, and drainage or viscosity: fluid leaves a contact in
a time that grows as its radius squared (doi 10.1063/1.3370354).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, product

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.stats import t

from tissueid.arrays import FloatArray
from tissueid.documents.quantities import Assumptions, Conditions, Quantity, Quoted
from tissueid.flags import Flag
from tissueid.inference.choice import Rival
from tissueid.inference.estimates import MAX_WIDTH, TissueEstimate, width_of
from tissueid.measured import TIMES_S
from tissueid.measured.geometry import KPA_PER_MPA, Geometry
from tissueid.measured.spectrum import HoldNumbers
from tissueid.model import functionals
from tissueid.model.channels import ChannelModel
from tissueid.model.moduli import FORMULAS, Contact, formulas_for, poroelastic_band
from tissueid.quantities import DEPTH_TEST

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

    window_s: float  # longest hold, longest log without one
    resolution_s: float  # two sampling intervals
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


#: Number of a tissue under some conditions, and two numbers at a depth.
Functional = Callable[[ChannelModel, FloatArray, Conditions], float]
Pair = Callable[[ChannelModel, FloatArray, float], tuple[float, float]]


@dataclass(frozen=True, slots=True)
class _Quoter:
    """Turns functions of theta into quantities with errors and verdicts."""

    tissue: TissueEstimate
    unknown: NDArray[np.bool_]

    def __call__(
        self, name: str, unit: str, at: Conditions, function: Functional, reason: str = ""
    ) -> Quantity:
        if reason:
            return Quantity(name, unit, at, None, None, reason)
        tissue = self.tissue
        value, stderr = functionals.delta_method(
            lambda theta: function(tissue.model, theta, at), tissue.theta, tissue.covariance, self.unknown
        )
        fraction = name.startswith("fraction")
        width = 2.0 * TWO_SIDED_95 * stderr if fraction else width_of(abs(value), stderr)
        if not np.isfinite(value):
            return Quantity(name, unit, at, None, None, "no finite value")
        if not width <= (MAX_FRACTION_WIDTH if fraction else MAX_WIDTH):
            return Quantity(name, unit, at, None, None, "the data do not determine it")
        return Quantity(name, unit, at, value, stderr, None)


def _static(model: ChannelModel, theta: FloatArray, at: Conditions) -> float:
    return float(model.static_force(theta, np.array([at.depth_mm or 0.0]))[0])


def _force(model: ChannelModel, theta: FloatArray, at: Conditions, time_s: float = 0.0) -> float:
    """Force a time after a ramp, or after an ideal step where no speed is given."""
    return functionals.force_after_ramp(model, theta, at.depth_mm or 0.0, at.speed_mm_s, time_s)


def _complex(model: ChannelModel, theta: FloatArray, at: Conditions) -> tuple[float, float]:
    """Storage and loss stiffness."""
    return functionals.complex_stiffness(model, theta, at.depth_mm or 0.0, at.frequency_Hz or 0.0)


def _over(part: float, whole: float) -> float:
    """Ratio, NaN where there is no whole: a law that ends above the depth of a hold has no force there."""
    return float(part) / float(whole) if whole > 0.0 else float("nan")


def _relaxation(quote: _Quoter, supported: Supported) -> Iterator[Quantity]:
    """Fraction relaxed after an ideal step and after the ramp of the longest hold."""
    model, hold = quote.tissue.model, supported.hold
    depth = hold.depth_mm or model.depth_mm
    slowest = float(model.times(quote.tissue.theta).max(initial=0.0))
    flat = f"its plateau was not seen: a relaxation time of {slowest:.3g} s in {supported.window_s:.3g} s"
    if slowest * PLATEAU_TIMES <= supported.window_s:
        flat = ""
    no_ramp = "" if hold.longest_s > 0.0 and hold.speed_mm_s > 0.0 else "no ramp with a hold was recorded"

    def lost(model: ChannelModel, theta: FloatArray, at: Conditions) -> float:
        """Share of the peak that is gone after a time."""
        return 1.0 - _over(_force(model, theta, at, at.time_s or 0.0), _force(model, theta, at))

    for path, speed, reason in (("step", None, ""), ("ramp", None if no_ramp else hold.speed_mm_s, no_ramp)):
        at = Conditions(path=path, depth_mm=depth, speed_mm_s=speed)
        for time in TIMES_S:
            why = reason or supported.no_time(time)
            yield quote("fraction_relaxed", "1", replace(at, time_s=time), lost, why)
        # peak over the force that stays
        yield quote("peak_to_plateau", "1", at, lambda *of: _over(_force(*of), _static(*of)), reason or flat)


def _oscillation(quote: _Quoter, supported: Supported, frequencies: Sequence[float]) -> Iterator[Quantity]:
    """Storage, loss, tan(delta) and energy of a cycle about half depth."""
    full = quote.tissue.model.depth_mm
    depth, amplitude = CYCLE_DEPTH * full, CYCLE_AMPLITUDE * full

    def energy(model: ChannelModel, theta: FloatArray, at: Conditions) -> float:
        return functionals.dissipated_per_cycle(model, theta, depth, amplitude, at.frequency_Hz or 0.0)

    for f in frequencies or FREQUENCIES_HZ:
        why = supported.no_frequency(f)
        if why and not frequencies:
            continue
        at = Conditions(frequency_Hz=f, depth_mm=depth)
        yield quote("storage_stiffness", "N/mm", at, lambda *of: _complex(*of)[0], why)
        yield quote("loss_stiffness", "N/mm", at, lambda *of: _complex(*of)[1], why)
        yield quote("tan_delta", "1", at, lambda *of: _over(*reversed(_complex(*of))), why)
        yield quote("dissipated_energy", "mJ", replace(at, amplitude_mm=amplitude), energy, why)


def _stiffness(quote: _Quoter) -> Iterator[Quantity]:
    """Instantaneous and equilibrium stiffness at half and full depth."""

    def part(both: Pair, which: int, model: ChannelModel, theta: FloatArray, at: Conditions) -> float:
        return both(model, theta, at.depth_mm or 0.0)[which]

    pairs = (functionals.equilibrium_stiffness, functionals.instantaneous_stiffness)
    kinds = dict(zip(("equilibrium", "instantaneous"), pairs, strict=True))
    for share, (kind, both) in product(STIFFNESS_SHARES, kinds.items()):
        at = Conditions(depth_mm=share * quote.tissue.model.depth_mm)
        for which, form in enumerate(("secant", "tangent")):
            yield quote(f"{kind}_{form}", "N/mm", at, partial(part, both, which))


def with_form(numbers: Quoted, rivals: Sequence[Rival]) -> Quoted:
    """The same numbers; shares that relax have half the range over laws as good in quadrature."""
    alike = [one for one in rivals if one.as_good]

    def told(one: Quantity) -> Quantity:
        if one.name not in {"fraction_relaxed", "peak_to_plateau"} or one.value is None or one.stderr is None:
            return one
        # a peak over what stays, p, is the share 1 - 1/p
        over = one.name == "peak_to_plateau"
        share, by = (1.0 - 1.0 / one.value, one.value**2) if over else (one.value, 1.0)
        form = max(0.5 * float(np.ptp([share, *(_share(rival, one.at) for rival in alike)])), LEAST_FORM)
        return replace(one, stderr=float(np.hypot(one.stderr, by * form)))

    return replace(numbers, model=tuple(map(told, numbers.model))) if alike else numbers


def _share(rival: Rival, at: Conditions) -> float:
    """Share of the peak that a rival's tissue loses, in the end where no time is given."""
    model, theta = rival.model, rival.theta
    times = np.array([0.0, np.inf if at.time_s is None else at.time_s])
    peak, later = _static(model, theta, at) + model.relaxing(theta, at.depth_mm or 0.0, times, at.speed_mm_s)
    return float(1.0 - later / peak)


def quoted_numbers(
    tissue: TissueEstimate,
    holds: Sequence[HoldNumbers],
    *,
    step_s: float,
    duration_s: float,
    frequencies_Hz: Sequence[float] = (),
) -> Quoted:
    """Functionals and spectra of one specimen; moduli are added by whoever knows a tip.

    ``frequencies_Hz``: none takes those of the usual ones that the data support.
    """
    most = max((one.longest_s for one in holds), default=0.0)
    # of holds equally long the deepest: the same protocol ends a sample earlier or later
    equal = [one for one in holds if one.longest_s >= EQUALLY_LONG * most]
    longest = max(equal, key=lambda one: one.depth_mm, default=HoldNumbers())
    window = longest.longest_s or duration_s
    supported = Supported(window_s=window, resolution_s=2.0 * step_s, hold=longest)
    quote = _Quoter(tissue, unknown_parameters(tissue))
    rows = _relaxation(quote, supported), _oscillation(quote, supported, frequencies_Hz), _stiffness(quote)
    return Quoted(
        window_s=window,
        resolution_s=2.0 * step_s,
        noise="white",
        model=tuple(chain.from_iterable(rows)),
        moduli=(),
        spectra=tuple(one for hold in holds for one in hold.spectra),
        assumptions=Assumptions(),
    )


#: Depths at which a modulus is given, as shares of the fitted depth.
SHARES = (0.5, 1.0)
#: Moduli at rest and at once.
MODULI = ("modulus_equilibrium", "modulus_instantaneous")


def _moduli(tissue: TissueEstimate, formula: str, depth: float, contact: Contact | None) -> list[Quantity]:
    """Moduli of a tissue at rest and at once by one formula, at one depth."""
    at = Conditions(formula=formula, doi=FORMULAS[formula], depth_mm=depth)
    if contact is None:
        reason = f"{formula} has no solution here: the contact is too wide for the layer"
        return [Quantity(name, "kPa", at, None, None, reason) for name in MODULI]
    quote, modulus_MPa = _Quoter(tissue, unknown_parameters(tissue)), contact.modulus_MPa
    rest, sudden = MODULI
    return [
        quote(rest, "kPa", at, lambda *of: KPA_PER_MPA * modulus_MPa(_static(*of))),
        quote(sudden, "kPa", at, lambda *of: KPA_PER_MPA * modulus_MPa(_force(*of))),
    ]


def _poroelastic(tissue: TissueEstimate, contact: Contact) -> list[Flag]:
    """Relaxation times that fluid flow under this contact could have as well."""
    tau = tissue.model.times(tissue.theta)
    low, high = poroelastic_band(contact.contact_mm)
    suspect = [float(value) for value in tau if low <= value <= high]
    if not suspect:
        return []
    times = ", ".join(f"{value:.3g}" for value in suspect)
    message = f"relaxation in {times} s lies where fluid drains from this contact, {low:.3g} to {high:.3g} s"
    values = {"tau_s": suspect, "contact_mm": contact.contact_mm, "from_s": low, "to_s": high}
    return [Flag("poroelastic", message, values)]


def with_moduli(
    quoted: Quoted, tissue: TissueEstimate, geometry: Geometry | None
) -> tuple[Quoted, list[Flag]]:
    """The same numbers with the moduli for a tip, where there is one, and what is to be said of them."""
    if geometry is None:
        return quoted, []
    rows: list[Quantity] = []
    outside: dict[str, tuple[str, ...]] = {}
    full = tissue.model.depth_mm
    deepest: Contact | None = None
    for formula in formulas_for(geometry.indenter, geometry.thickness_mm):
        for share in SHARES:
            contact = geometry.contact(formula, share * full)
            rows += _moduli(tissue, formula, share * full, contact)
        if contact is not None:
            deepest = deepest or contact
            if contact.outside:
                outside[formula] = contact.outside
    flags = [] if deepest is None else _poroelastic(tissue, deepest)
    if outside:
        formula, limits = next(iter(outside.items()))
        more = f"; {len(outside)} formulas in all" if len(outside) > 1 else ""
        values = {"formulas": list(outside), "depth_mm": full}
        words = f"at {full:.3g} mm {formula} is outside its range: {limits[0]}{more}"
        flags.append(Flag("modulus_out_of_range", words, values))
    return replace(quoted, moduli=tuple(rows), assumptions=geometry.stated()), flags


#: Slopes of ln tau on ln contact radius of a viscous tissue and of one that drains.
VISCOUS, DRAINAGE = 0.0, 2.0
#: Ratio of the largest to the smallest contact radius, depth over tip radius, and holds, that can decide.
FEWEST_RATIO, BURIED, FEWEST_HOLDS = 1.1, 0.5, 3
#: Least standard deviation of ln tau: two holds at one site agree no better.
LEAST_SD = 0.02


def depth_test(
    geometry: Geometry | None, depths_mm: Sequence[float], tau_s: Sequence[float]
) -> tuple[Quantity | None, tuple[Flag, ...]]:
    """Slope of ln tau on ln contact radius over equally long holds, and its flag.

    ``verdict`` and 95 % interval are among its conditions; without a tip, or under a flat punch, nothing
    is tested.
    """
    if geometry is None or geometry.indenter.shape == "flat" or len(depths_mm) < FEWEST_HOLDS:
        return None, ()
    formula = formulas_for(geometry.indenter, geometry.thickness_mm)[0]
    contacts = [geometry.contact(formula, depth) for depth in depths_mm]
    radius = np.array([np.nan if one is None else one.contact_mm for one in contacts])
    if not np.isfinite(radius).all() or radius.max() < FEWEST_RATIO * radius.min():
        return None, ()
    deepest = float(max(depths_mm))
    at = Conditions(depth_mm=deepest, holds=float(len(depths_mm)))
    tip = geometry.indenter.radius_mm
    if geometry.indenter.shape == "sphere" and tip is not None and deepest > BURIED * tip:
        reason = f"the tip is buried: {deepest:.3g} mm of depth, {tip:.3g} mm of radius"
        return Quantity(DEPTH_TEST, "1", at, None, None, reason), ()
    slope, error, half = _slope(np.log(radius), np.log(tau_s))
    verdict = _verdict(slope - half, slope + half)
    at = replace(at, low=slope - half, high=slope + half, verdict=verdict)
    flags: tuple[Flag, ...] = ()
    if verdict == "drainage":
        power = f"{slope:.2f} [{slope - half:.2f}, {slope + half:.2f}] to {deepest:.3g} mm"
        words = f"relaxation times grow as the contact radius to the power {power}: fluid drains"
        flags = (Flag("poroelastic", words, {"slope": slope, "stderr": error}),)
    return Quantity(DEPTH_TEST, "1", at, slope, error, None), flags


def _slope(x: FloatArray, y: FloatArray) -> tuple[float, float, float]:
    """Slope of a line, its standard error, and half its 95 % interval."""
    off, freedom = x - x.mean(), x.size - 2
    slope = float(off @ y / (off @ off))
    rest = y - y.mean() - slope * off
    sd = max(float(np.sqrt(rest @ rest / freedom)), LEAST_SD)
    error = sd / float(np.sqrt(off @ off))
    return slope, error, float(t.ppf(0.975, freedom)) * error


def _verdict(low: float, high: float) -> str:
    """One of drainage, viscous, neither, can't decide."""
    viscous, drains = low <= VISCOUS <= high, low <= DRAINAGE <= high
    if viscous == drains:
        return "can't decide" if viscous else "neither"
    return "viscous" if viscous else "drainage"
