"""The tissue of paper A as far as its text tells, and Figs. 3 and 4: its force at constant speed.

Force at constant speed is equation (7), reconstructed; the static cubic is equation (8).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.reproduction import Figure, Item, Trace
from tissueid.model.channels import ChannelModel, loading_force
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.rupture import hardening_ratio, rupture_at_speed
from tissueid.reproduce.published import SADEGHNEJAD, Ledger, Readings, Said, points
from tissueid.synth.recipe import HOLD_SPEED_MM_MIN, SPEEDS_MM_MIN, Branch

#: Depths of the relaxation tests, section II.A of the paper.
DEPTHS_MM = (2, 4, 6, 8)
#: A model claims depths up to here [mm]; the deepest test.
DEPTH_MM = 8.0


@dataclass(frozen=True, slots=True)
class Tissue:
    """A modified Kelvin-Voigt tissue with one branch."""

    static: tuple[float, ...]  # a1, a2, a3 [N/mm, N/mm2, N/mm3]
    branch: Branch

    @property
    def model(self) -> ChannelModel:
        """Its law."""
        return kelvin_voigt(branches=1, stiffness_degree=len(self.branch.stiffness) - 1, depth_mm=DEPTH_MM)

    @property
    def theta(self) -> FloatArray:
        """Its vector."""
        return np.array([*self.static, *self.branch.stiffness, self.branch.tau_s])

    def force(self, depth_mm: FloatArray, speed_mm_min: float) -> FloatArray:
        """Force at depths reached at constant speed from rest [N]."""
        return loading_force(self.model, self.theta, depth_mm, speed_mm_s=speed_mm_min / 60.0)


def read_branch(ledger: Ledger, readings: Readings, tau_key: str = "table-2/tau") -> Branch:
    """The branch of Table 2, with the relaxation time of a row of choice."""
    ledger.read(readings.words("stiffness"))
    ledger.read(readings.words("relaxation"))
    value = ledger.printed("table-2/stiffness")
    tau = ledger.printed(tau_key)
    stiffness = (value,) if readings.stiffness == "constant" else (0.0, value)
    return Branch(stiffness, tau if readings.relaxation == "time" else 1.0 / tau)


def branch_force(branch: Branch, depth_mm: float, speed_mm_min: float) -> float:
    """Force of the branch alone at the end of a ramp [N]."""
    alone = Tissue((0.0, 0.0, 0.0), branch)
    return float(alone.force(np.array([depth_mm]), speed_mm_min)[0])


def cubic_through_peaks(ledger: Ledger, branch: Branch) -> tuple[float, ...]:
    """Least-squares cubic without a constant through the peaks of Table 1, less what the branch carries [N].

    The four peaks lie on no cubic through the origin (up to 8 N off): they come from different specimens or
    places, and the curve is one for illustration.
    """
    depth = np.array(DEPTHS_MM, dtype=float)
    peaks = np.array([ledger.printed(f"table-1/peak-{d}mm") for d in DEPTHS_MM])
    rest = peaks - np.array([branch_force(branch, d, HOLD_SPEED_MM_MIN) for d in depth])
    columns = depth[:, None] ** np.arange(1.0, 4.0)
    return tuple(float(a) for a in np.linalg.lstsq(columns, rest, rcond=None)[0])


def tissue_through_peaks(ledger: Ledger, readings: Readings) -> Tissue:
    """The branch of Table 2 beside the cubic through Table 1."""
    branch = read_branch(ledger, readings)
    return Tissue(cubic_through_peaks(ledger, branch), branch)


#: A static curve whose tangent exceeds its secant, in place of the lost coefficients [N/mm3].
HARDENING = (0.0, 0.0, 0.43)
#: Depth at which a tissue that is indented infinitely slowly ruptures [mm].
RUPTURE_DEPTH_MM = 6.0
#: Points of a drawn curve.
DRAWN = 161


def force_displacement(readings: Readings) -> tuple[list[Item], Figure]:
    """Fig. 3: six speeds to 8 mm, and whether force grows with speed."""
    ledger = Ledger(SADEGHNEJAD, "Fig. 3")
    tissue = tissue_through_peaks(ledger, readings)
    depth = np.linspace(0.0, float(DEPTHS_MM[-1]), DRAWN)
    curves = np.array([tissue.force(depth, speed) for speed in SPEEDS_MM_MIN])
    items = [
        ledger.item(
            f"figure-3/increment-{speed:.0f}",
            float(curve[-1] - curves[0, -1]),
            said=Said(f"Force at 8 mm and {speed:.0f} mm/min above that at 10 mm/min", "N"),
            note="the paper prints no numbers on the axes of this figure",
        )
        for speed, curve in zip(SPEEDS_MM_MIN[1:], curves[1:], strict=True)
    ]
    items.append(
        ledger.claim(
            "figure-3/grows",
            Said(
                "Force at a given displacement grows with speed: least growth from speed to speed, "
                "from 1 mm on",
                "N",
            ),
            float(np.diff(curves[:, depth >= 1.0], axis=0).min()),
            lambda least: least > 0.0,
            "greater than zero everywhere",
        )
    )
    traces = [
        Trace(f"{speed:.0f} mm/min", points(depth), points(curve), "line", None)
        for speed, curve in zip(SPEEDS_MM_MIN, curves, strict=True)
    ]
    caption = (
        "A cubic through the peaks of Table 1, less what the branch carries (residuals up to 8 N: the peaks "
        "come from different specimens or places), and the branch of Table 2, by equation (7)."
    )
    words, axes = ("Force against displacement, six speeds", caption), ("Displacement [mm]", "Force [N]")
    return items, ledger.figure("figure-3", "recomputed", words, axes, traces)


def rupture_force(tissue: Tissue, speed_mm_min: float, criterion: str, slow_depth_mm: float) -> float:
    """Force at which a tissue ruptures that would, infinitely slowly, rupture at a given depth [N].

    ``criterion``: of :data:`tissueid.rupture_law.CRITERIA`; none of them follows from the model.
    """
    powers = np.arange(1, len(tissue.static) + 1)
    energy = float(np.sum(np.array(tissue.static) * slow_depth_mm ** (powers + 1) / (powers + 1)))
    force = float(np.sum(np.array(tissue.static) * slow_depth_mm**powers))
    slow = {"work": energy, "stored-energy": energy, "weighted-force": force, "depth": slow_depth_mm}
    speed = speed_mm_min / 60.0
    found = rupture_at_speed(tissue.model, tissue.theta, criterion, slow[criterion], speed_mm_s=speed)
    return np.nan if found is None else found["force"]


def peak_against_speed(readings: Readings) -> tuple[list[Item], Figure]:
    """Fig. 4 under the chosen criterion, for two static curves, and the sentence that (7) predicts a fall."""
    items: list[Item] = []
    traces: list[Trace] = []
    for name, curve in (("hardening", "0.43 x^3"), ("table-1", "cubic through Table 1")):
        ledger = Ledger(SADEGHNEJAD, "Fig. 4")
        branch = read_branch(ledger, readings)
        ledger.read(readings.words("criterion"))
        static = (
            ledger.assume(f"static curve {curve} N", HARDENING)
            if name == "hardening"
            else cubic_through_peaks(ledger, branch)
        )
        slow = ledger.assume("rupture at 6 mm when indented infinitely slowly", RUPTURE_DEPTH_MM)
        tissue = Tissue(static, branch)
        hardens = hardening_ratio(
            tissue.model, tissue.theta, slow, float(np.polyval([*static[::-1], 0.0], slow))
        )
        peaks = [rupture_force(tissue, speed, readings.criterion, slow) for speed in SPEEDS_MM_MIN]
        for speed, peak in ((SPEEDS_MM_MIN[0], peaks[0]), (SPEEDS_MM_MIN[-1], peaks[-1])):
            items.append(
                ledger.item(
                    f"figure-4/{name}-{speed:.0f}",
                    peak,
                    said=Said(f"Peak force at {speed:.0f} mm/min, {curve}", "N"),
                    note="the paper prints no numbers on the axes of this figure",
                )
            )
        items.append(
            ledger.claim(
                f"figure-4/{name}-falls",
                Said(f"Peak force falls with speed, {curve}: from 10 to 500 mm/min it changes by", "N"),
                peaks[-1] - peaks[0],
                lambda change: change < 0.0,
                "less than zero",
                note=f"x F_s'/F_s is {hardens:.2f} at 6 mm; under constant work the peak falls with speed "
                "where it is above 1",
            )
        )
        traces.append(Trace(curve, SPEEDS_MM_MIN, points(peaks), "line", None))
    items.append(_by_seven(readings))
    caption = (
        f"Reading: {readings.words('criterion')}. Under constant work the static curve decides: the peak "
        "falls where the tangent stiffness exceeds the secant at rupture (x F_s'/F > 1). Constant work "
        "contradicts the model's own source, by which the absorbed energy falls with speed."
    )
    words, axes = ("Peak force against speed", caption), ("Speed [mm/min]", "Peak force [N]")
    return items, Ledger(SADEGHNEJAD, "Fig. 4").figure("figure-4", "assumed", words, axes, traces)


def _by_seven(readings: Readings) -> Item:
    """Peak at a fixed depth by (7) alone."""
    ledger = Ledger(SADEGHNEJAD, "Fig. 4")
    tissue = tissue_through_peaks(ledger, readings)
    slow, fast = (tissue.force(np.array([RUPTURE_DEPTH_MM]), SPEEDS_MM_MIN[k])[0] for k in (0, -1))
    return ledger.claim(
        "figure-4/by-equation-7",
        Said(
            "Average maximum force is a decreasing function of velocity, as predicted by (7): at 6 mm, from "
            "10 to 500 mm/min, (7) changes the force by",
            "N",
        ),
        float(fast - slow),
        lambda change: change < 0.0,
        "less than zero",
        note="equation (7) alone lets force grow with speed at every depth; a fall needs a criterion of "
        "rupture, and under constant work a static curve that hardens",
    )
