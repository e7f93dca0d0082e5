"""Cohorts that are tested to rupture, with the truth: 18 tests, 6 specimens at three speeds each.

The truth is made by the synthetic tissue alone: the measure of its contact force along the path of each test.
Specimens differ in stiffness and, independently, in threshold; tests of one specimen in threshold.
"""

from dataclasses import replace

import numpy as np

from tissueid.documents.rupture import Test as Failure
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.rupture.failures import LoadedTest, SpecimenLaw, failures_of
from tissueid.synth import Branch, Log, Move, Rupture, as_trials, recipe, simulate
from tissueid.synth.simulate import Body, crosshead_path, rupture_of
from tissueid.trial import Trial

#: Depth of rupture of the typical tissue at the middle speed, whatever the criterion [mm].
TYPICAL_MM = 5.3
PROTOCOL = recipe("rupture-18")
SPEEDS_MM_MIN = (120.0, 600.0, 3000.0)
SPECIMEN_CV = 0.15
DEEPEST_MM = 12.0
PATH_SAMPLES = 400
TAU_S = PROTOCOL.branches[0].tau_s


def typical_threshold(criterion: str) -> float:
    """The measure that the typical tissue reaches at TYPICAL_MM and the middle speed, found by bisection."""
    low, high = 1e-3, 1e5
    for _ in range(60):
        middle = (low * high) ** 0.5
        path = crosshead_path(Log("ramp", (Move(DEEPEST_MM, SPEEDS_MM_MIN[1]),)))
        found = rupture_of(Rupture(criterion, middle), path, Body(PROTOCOL.static, PROTOCOL.branches))
        late = not found["ruptured"] or found["rupture_depth_mm"] > TYPICAL_MM
        low, high = (low, middle) if late else (middle, high)
    return (low * high) ** 0.5


def _factor(cv: float, rng: np.random.Generator) -> float:
    return float(np.exp(np.log1p(cv * cv) ** 0.5 * rng.standard_normal()))


def known_cohort(criterion, cv, seed, *, threshold, speeds=SPEEDS_MM_MIN, stop_mm=DEEPEST_MM):
    """Failures of a cohort whose laws are known and whose ends were measured without error."""
    rng = np.random.default_rng(seed)
    model = kelvin_voigt(1, 0, DEEPEST_MM)
    found: list[Failure] = []
    for specimen in range(18 // len(speeds)):
        gain, tough = _factor(SPECIMEN_CV, rng), _factor(SPECIMEN_CV, rng)
        static = tuple(gain * a for a in PROTOCOL.static)
        stiffness = gain * PROTOCOL.branches[0].stiffness[0]
        tests = []
        for speed in speeds:
            broken = rupture_of(
                Rupture(criterion, threshold * tough * _factor(cv, rng)),
                crosshead_path(Log("ramp", (Move(stop_mm, speed),))),
                Body(static, (Branch((stiffness,), TAU_S),)),
            )
            depth = np.linspace(0.0, broken["rupture_depth_mm"], PATH_SAMPLES)
            test = LoadedTest(
                path=f"{specimen}-{speed:g}",
                sheet=None,
                ruptured=bool(broken["ruptured"]),
                time_s=depth / (speed / 60.0),
                depth_mm=depth,
                force_N=broken["rupture_force_N"],
                work_N_mm=broken["rupture_work_N_mm"],
                force_sd_N=0.0,
                step_mm=0.0,
                contact_sd_mm=0.0,
                speed_mm_s=speed / 60.0,
                residual=0.2 if broken["ruptured"] else None,
            )
            tests.append((test, 0.0))
        theta = np.array([*static, stiffness, TAU_S])
        found += failures_of(SpecimenLaw(f"{specimen}", model, theta, np.zeros((5, 5))), tests)
    return found


def recorded_cohort(criterion: str, cv: float, seed: list[int], *, threshold: float) -> list[Trial]:
    """Recordings of such a cohort, with contact to be found, noise and samples."""
    rupture = Rupture(criterion, threshold, cv=cv, cv_specimen=SPECIMEN_CV)
    plan = replace(PROTOCOL, rate_Hz=500.0, cv_specimen=SPECIMEN_CV, rupture=rupture)
    return as_trials(simulate(plan, rng=np.random.default_rng(seed)))
