"""Protocols whose predicted precision is compared with fits of simulated recordings.

Everything is fixed here before it is run: tissue, machine, protocol, noise, seed, number of runs.
"""

from dataclasses import dataclass, replace

import numpy as np

from tissueid import FitOptions, IdentifyOptions, identify
from tissueid.arrays import FloatArray
from tissueid.design.machine import PRESETS, Machine, Setting
from tissueid.design.plan import matched_wants, planned
from tissueid.design.precision import Asked, Indentation, Ledger, Protocol, given_protocol, ramp_of
from tissueid.design.tissues import Tissues, of_draws
from tissueid.documents.design import Want
from tissueid.manifest import Study
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.priors import CALIBRATION_DEFAULTS, CalibrationPrior, Priors
from tissueid.selfcheck.protocol import Centre, in_air_first
from tissueid.selfcheck.protocol import Protocol as Recorded
from tissueid.selfcheck.tissue import KNOWN_MACHINE, TissueCheck, tissue_check
from tissueid.selfcheck.truth import ProtocolLog, Truth, Widths, numbers_of
from tissueid.synth import recipe

TAU, ETA = "relaxation_time_s", "viscosity_N_s_per_mm"
#: Priors so wide that they say nothing beside the data.
WEAK = Widths(curve=2.0, ln_tau=2.0)


def silent(_message: str, _done: int, _total: int) -> None:
    return None


def one_tissue(static: tuple[float, ...], branches: tuple[tuple[tuple[float, ...], float], ...]) -> Tissues:
    degree = len(branches[0][0]) - 1
    model = kelvin_voigt(branches=len(branches), stiffness_degree=degree, depth_mm=8.0)
    theta = model.join(
        np.array(static), np.array([k for k, _ in branches]), np.array([tau for _, tau in branches])
    )
    return of_draws("a stated tissue", "stated", model, theta, count=1, known_depth_mm=None)


def asked_for(wants: dict[str, float], machine: Machine, **more: object) -> Asked:
    named = tuple(Want(name, share) for name, share in wants.items())
    plain = Asked(wants=named, max_depth_mm=8.0, max_force_N=machine.max_force_N)
    return replace(plain, **more)


@dataclass(frozen=True)
class Case:
    """One protocol on one tissue and machine."""

    name: str
    tissues: Tissues
    machine: Machine
    setting: Setting
    protocol: Protocol
    asked: Asked
    seed: int

    @property
    def ledger(self) -> Ledger:
        return Ledger(self.machine, self.setting, self.tissues, self.asked)

    def predicted(self) -> dict[str, float]:
        found = self.ledger.precision(self.protocol)
        return {want.name: float(sd[0]) for want, sd in zip(self.asked.wants, found.sd, strict=True)}

    def check(self) -> TissueCheck:
        logs = tuple(
            log
            for number, (test, count) in enumerate(self.protocol.items())
            for log in recorded_logs(test, self.machine, self.setting, count, f"log-{number}")
        )
        speeds = [test.speed_mm_s for test in self.protocol]
        recorded = Recorded(words=self.name, logs=logs, speeds_mm_s=(min(speeds), max(speeds)))
        centre = Centre(self.tissues.model, self.tissues.theta[0], self.setting.noise_N, self.setting.phi)
        stated = Priors(calibration=self.instrument())
        check = tissue_check(recorded, centre, stated=stated, widths=WEAK, defects=self.asked.total)
        # a plan knows contact points to the machine's standard deviation
        return replace(check, contact_stated=True)

    def instrument(self) -> dict[str, CalibrationPrior]:
        """The calibration that the machine states, as the priors of a study."""
        means = {
            "force_gain": 1.0,
            "displacement_gain": 1.0,
            "skew_s": 0.0,
            "force_filter_s": self.setting.filter_s,
            "frame_compliance_mm_per_N": self.machine.compliance_mm_per_N,
        }
        return {
            name: CalibrationPrior(means[name], sd, lower=CALIBRATION_DEFAULTS[name].lower, stated=True)
            for name, sd in self.machine.calibration_sd(self.setting).items()
        }

    def numbers(self, theta: FloatArray) -> dict[str, FloatArray]:
        """Logarithms of the wanted numbers; the viscosity at the depth the case has it."""
        found = numbers_of(self.tissues.model, np.atleast_2d(theta), ())
        return {want.name: np.log(found[want.name]) for want in self.asked.wants}


def recorded_logs(
    test: Indentation, machine: Machine, setting: Setting, count: int, name: str
) -> list[ProtocolLog]:
    ramp = ramp_of(test, machine)
    time = np.arange(max(int(np.ceil((ramp.seconds + test.hold_s) * setting.rate_Hz)), 2)) * setting.step_s
    depth = ramp.depth(time)
    told = {"speed_mm_s": test.speed_mm_s, "contact_sd_mm": machine.contact_sd_mm}
    return [in_air_first(f"{name}-{repeat}", time, depth, **told) for repeat in range(count)]


def simulated_errors(case: Case, runs: int) -> dict[str, FloatArray]:
    """Error of the logarithm of every wanted number in each run: the fit's own point estimate.

    Where the calibration counts, its defects are drawn anew each run, and the estimate is the mean of the
    posterior that knows their priors.
    """
    check = case.check()
    rng = np.random.default_rng(case.seed)
    true = case.numbers(case.tissues.theta)
    errors: dict[str, list[float]] = {name: [] for name in true}
    size = {"branches": check.model.branches, "stiffness_degree": check.model.stiffness_degree}
    order = FitOptions(**size, static=check.pooling, noise=check.noise_model)
    options = IdentifyOptions(fit=order, segment=check.segmentation)
    study = Study("a machine that is known", calibration=KNOWN_MACHINE)
    for _ in range(runs):
        trials = check.trials(_truth(case, check, rng), rng)
        if case.asked.total:
            found = case.numbers(check.drawn(check.identified(trials, seed=int(rng.integers(2**31)))))
        else:
            (fit,) = identify(trials, study=study, options=options).specimens
            found = case.numbers(fit.theta)
        for name, values in found.items():
            errors[name].append(float(values.mean() - true[name][0]))
    return {name: np.array(values) for name, values in errors.items()}


def _truth(case: Case, check: TissueCheck, rng: np.random.Generator) -> Truth:
    logs = len(check.logs)
    calibration = {}
    if case.asked.total:
        calibration = {
            name: max(prior.mean + prior.sd * float(rng.standard_normal()), prior.lower)
            for name, prior in check.priors.calibration.items()
        }
    return Truth(
        theta=case.tissues.theta[0],
        gain=np.exp(case.asked.gain_sd * rng.standard_normal(logs)),
        slower=np.exp(case.asked.time_sd * rng.standard_normal(logs)),
        offset_mm=case.machine.contact_sd_mm * rng.standard_normal(logs),
        sigma_N=case.setting.noise_N,
        phi=case.setting.phi,
        gain_sd=case.asked.gain_sd,
        calibration=calibration,
    )


def _recommended(
    name: str, tissues: Tissues, machine: Machine, wants: dict[str, float], seed: int, **more: object
) -> Case:
    asked = asked_for(wants, machine, **more)
    best = planned(machine, tissues, asked, silent).best
    return Case(name, tissues, machine, best.setting, best.protocol, asked, seed)


PAPER_A = one_tissue((20.0, -1.2, 0.35), (((63.62,), 0.021),))
SOFT = one_tissue((2.0, 0.1, 0.02), (((3.0, 0.5), 0.3),))
TWO = one_tissue((10.0, 0.5, 0.1), (((20.0,), 0.08), ((8.0,), 2.0)))


def paper_a() -> Case:
    """The protocol that paper A prints, 30 logs at 1 kHz."""
    machine = PRESETS["paper-a"]
    protocol = given_protocol(recipe("paper-a-30"))
    asked = asked_for({TAU: 0.05, ETA: 0.05}, machine)
    return Case("paper A", PAPER_A, machine, machine.settings[0], protocol, asked, 20261)


def better_than_paper_a() -> Case:
    """Recommended for the precision that paper A's protocol has."""
    given = paper_a()
    wants = {
        want.name: want.share
        for want in matched_wants(given.protocol, given.machine, given.tissues, given.asked)
    }
    return _recommended("for paper A's precision", PAPER_A, given.machine, wants, 20262)


def correlated() -> Case:
    """A soft tissue with growing K under AR(1) noise, phi = 0.9 at 100 Hz."""
    setting = Setting(100.0, 0.4, noise_correlation_s=-0.01 / float(np.log(0.9)))
    machine = replace(PRESETS["bench"], frame_stiffness_N_per_mm=None, settings=(setting,))
    return _recommended("AR(1) noise", SOFT, machine, {TAU: 0.03, ETA: 0.02}, 20263, gain_sd=0.01)


def filtered() -> Case:
    """A filter of 10 ms known to 0.5 ms, a frame of 2000 N/mm known to a tenth, gains and skew: the total."""
    setting = Setting(200.0, 1.0, filter_s=0.01, filter_sd_s=0.0005)
    defects = {"force_gain_sd": 0.005, "displacement_gain_sd": 0.005, "skew_sd_s": 0.0005}
    machine = replace(PRESETS["bench"], settings=(setting,), **defects)
    tissue = one_tissue((6.0, 0.3, 0.05), (((20.0,), 0.08),))
    return _recommended(
        "a load filter, total", tissue, machine, {TAU: 0.02, ETA: 0.015}, 20264, total=True, gain_sd=0.01
    )


def two_branches() -> Case:
    """Two branches, both relaxation times and viscosities wanted."""
    machine = replace(PRESETS["bench"], settings=(Setting(200.0, 1.0),))
    wants = {TAU: 0.03, f"{TAU}_b2": 0.03, ETA: 0.03, f"{ETA}_b2": 0.03}
    return _recommended("two branches", TWO, machine, wants, 20265, gain_sd=0.01)


CASES = (paper_a, better_than_paper_a, correlated, filtered, two_branches)
