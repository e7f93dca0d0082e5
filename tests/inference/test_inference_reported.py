"""Numbers read off draws: bands, budgets, intervals; flags of a specimen, each with its number."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fit_factory import specimen_fit
from scipy.optimize import brentq

from tissueid.documents import plain, typed
from tissueid.documents.identification import NoiseFit, Nrmsd
from tissueid.flags import Flag
from tissueid.inference import reported, verdict
from tissueid.inference.estimates import ProfileInterval, TissueEstimate
from tissueid.inference.reported import BAND_DRAWS, interval95, reported_draws, uncertainty_budget
from tissueid.inference.system import MACHINE
from tissueid.inference.verdict import outside, withheld
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.result import Estimate, SpecimenFit
from tissueid.uncertainty import ParameterUncertainty

SIGMA = 0.3


def bands_of(
    count: int, change_of: Callable[[np.ndarray, float], np.ndarray], vectors: np.ndarray | None = None
) -> tuple[SpecimenFit, list[np.ndarray]]:
    """Bands of logs whose observations are the samples of their curves; what a draw makes of their force."""
    fit = specimen_fit(trials=count, samples=300)
    fit = replace(fit, trials=fit.trials[:count])
    times = [trial.curve.time_s for trial in fit.trials]
    force = np.concatenate([trial.curve.model_N for trial in fit.trials])
    system = SimpleNamespace(
        log=np.repeat(np.arange(len(times)), [one.size for one in times]),
        mid=np.concatenate(times),
        logs=[SimpleNamespace(time_s=one) for one in times],
    )
    target = SimpleNamespace(system=system, forces=lambda x: np.stack([change_of(force, k) for k in x[:, 0]]))
    vectors = np.random.default_rng(0).standard_normal((BAND_DRAWS, 1)) if vectors is None else vectors
    return fit, list(reported.predictive_bands(fit, target, vectors, sigma_N=SIGMA).values())  # type: ignore[arg-type]


FAR_OUT = np.where(np.arange(BAND_DRAWS) == 3, 1e4, 0.0)[:, None]


@pytest.mark.parametrize(
    ("count", "change_of", "vectors"),
    [
        (1, lambda force, _: force, None),
        (1, lambda force, x: force + x, FAR_OUT),
        # a log among others takes up by its gain what all depths share
        (2, lambda force, x: force * (1.0 + 0.1 * x), None),
    ],
)
def test_where_draws_tell_nothing_more_the_noise_is_the_band(count, change_of, vectors) -> None:
    fit, bands = bands_of(count, change_of, vectors)
    for trial, (low, middle, high) in zip(fit.trials, bands, strict=True):
        assert np.array_equal(middle, trial.curve.model_N)
        assert high - low == pytest.approx(2 * 1.96 * SIGMA, rel=1e-3)


def test_draws_widen_the_band_by_their_spread() -> None:
    slope = np.linspace(0.0, 2.0, 300)
    _, ((low, _, high),) = bands_of(1, lambda force, x: force + slope[: force.size] * x)
    # a hundred draws know their spread to some ten per cent
    assert (high - low) / 2 == pytest.approx(1.96 * np.hypot(slope[: low.size], SIGMA), rel=0.2)
    assert (high - low)[-1] > 4.0 * (high - low)[0]
    _, ((low, _, high),) = bands_of(1, lambda force, x: force * (1.0 + 0.1 * x))
    assert (high - low).max() > 2 * 2 * 1.96 * SIGMA


NAMES = ("ln_tau_1", *MACHINE, "linear_1", "contact", "ln_sigma")
#: Change of the parameter by one standard deviation of each source, and of noise beside them.
PARTS = {"frame": 3.0, "time skew": 0.0, "force filter": -2.0, "contact points": 1.0, "force gain": 4.0,
         "displacement gain": 0.5}  # fmt: skip
NOISE = 2.5


def target(free=None):
    free = np.ones(len(NAMES), dtype=bool) if free is None else free
    return SimpleNamespace(names=NAMES, free=free)


def drawn(n=40_000, seed=1):
    rng = np.random.default_rng(seed)
    vectors, gains = rng.standard_normal((n, len(NAMES))), rng.standard_normal((n, 2))
    value = NOISE * rng.standard_normal(n)
    for name, k in (("frame", 1), ("time skew", 2), ("force filter", 3), ("contact points", 5)):
        value = value + PARTS[name] * vectors[:, k]
    value = value + PARTS["force gain"] * gains[:, 0] + PARTS["displacement gain"] * gains[:, 1]
    # scales of the sources are their own
    return vectors * [1.0, 4e-3, 2e-3, 5e-3, 20.0, 0.01, 0.1], 1.0 + 0.01 * gains, value


def test_shares_are_those_of_the_linear_dependence():
    vectors, gains, value = drawn()
    rows = {row.source: row for row in uncertainty_budget(target(), vectors, gains, {"a": 50.0 + value})}
    assert set(rows) == {"noise", reported.TOTAL, *PARTS}
    whole = sum(one**2 for one in PARTS.values()) + NOISE**2
    for name, part in {**PARTS, "noise": NOISE}.items():
        # 40,000 draws know a covariance to half a per cent of the whole
        assert rows[name].share == pytest.approx(part**2 / whole, abs=0.02), name
        assert rows[name].sd == pytest.approx(abs(part), abs=0.15), name
    assert rows[reported.TOTAL].share is None
    assert rows[reported.TOTAL].sd == pytest.approx(value.std(), rel=1e-9)
    assert sum(row.share for row in rows.values() if row.share is not None) == pytest.approx(1.0)


def test_every_parameter_has_its_rows_noise_first_and_the_total_last():
    vectors, gains, value = drawn(500)
    rows = uncertainty_budget(target(), vectors, gains, {"a": value, "b": 2.0 * value})
    assert [row.parameter for row in rows] == ["a"] * 8 + ["b"] * 8
    assert [row.source for row in rows[::8]] == ["noise"] * 2
    assert [row.source for row in rows[7::8]] == [reported.TOTAL] * 2
    assert rows[8 + 3].sd == pytest.approx(2.0 * rows[3].sd)
    free = np.array([name not in {"contact", "skew_s"} for name in NAMES])
    held = {row.source for row in uncertainty_budget(target(free), vectors, gains, {"a": value})}
    assert held == {"noise", "frame", "force filter", "force gain", "displacement gain", reported.TOTAL}


def test_what_is_known_exactly_has_no_share():
    vectors, gains, value = drawn(2_000)
    vectors[:, 1], gains[:, 0] = 0.0, 1.0
    rows = {row.source: row for row in uncertainty_budget(target(), vectors, gains, {"a": value})}
    assert (rows["frame"].share, rows["force gain"].share) == pytest.approx((0.0, 0.0), abs=1e-12)
    still = uncertainty_budget(target(), vectors, gains, {"a": np.ones(2_000)})
    assert all(row.sd == 0.0 for row in still)


MODEL = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=4.0)
OPTIMUM = np.array([2.0, 0.1, 0.0, 5.0, 0.5])


def tissue(theta: np.ndarray = OPTIMUM) -> TissueEstimate:
    values = reported_draws(MODEL, theta[None])
    parameters = tuple(
        Estimate(name, name, "", float(one[0]), 0.1, identified=True, detail={"estimate": float(one[0])})
        for name, one in values.items()
    )
    return TissueEstimate(MODEL, theta, np.eye(theta.size), parameters, (), bounded=True)


def draws(centre: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    out = np.tile(centre, (4000, 1))
    out[:, :3] += np.array([0.05, 0.01, 0.002]) * rng.standard_normal((4000, 3))
    viscosity = centre[3] * centre[4] * np.exp(0.02 * rng.standard_normal(4000))
    out[:, 4] = centre[4] * np.exp(0.2 * rng.standard_normal(4000))
    out[:, 3] = viscosity / out[:, 4]
    return out


def uncertainties(theta: np.ndarray, wider: float | None = 1.5) -> dict[str, ParameterUncertainty]:
    out = {}
    for name, (low, high) in interval95(reported_draws(MODEL, theta)).items():
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        total = None if wider is None else (middle - wider * half, middle + wider * half)
        out[name] = ParameterUncertainty(middle, half / 2.0, (low, high), total, 1e3, 1e3, 1.0)
    return out


def test_a_value_outside_an_interval_of_its_is_named() -> None:
    parameters, rng = tissue().parameters, np.random.default_rng(1)
    found = uncertainties(draws(OPTIMUM, rng))
    assert outside(parameters, found) == ()
    shifted = uncertainties(draws(OPTIMUM + np.array([0.2, 0.0, 0.0, 0.0, 0.0]), rng))
    assert outside(parameters, shifted) == ("static_1_N_per_mm",)
    assert outside(tuple(replace(one, value=None) for one in parameters), shifted) == ()
    # a total interval that is missing counts as outside where others have one
    name = next(iter(found))
    assert outside(parameters, found | {name: replace(found[name], ci95_total=None)}) == (name,)
    assert outside(parameters, uncertainties(draws(OPTIMUM, rng), wider=None)) == ()


@pytest.mark.parametrize(
    ("prediction", "reaches"), [((1.5, 3.0), False), ((2.01, 2.1), False), ((3.0, 4.32), True), (None, False)]
)
def test_an_interval_reaches_to_logs_fitted_alone_where_they_have_it_elsewhere(prediction, reaches) -> None:
    name, found = "static_1_N_per_mm", uncertainties(draws(OPTIMUM, np.random.default_rng(1)))
    found[name] = replace(found[name], prediction95=prediction)
    values = {one.name: one.value for one in tissue().parameters}
    out, flags = verdict.reaching({key: ("a", value) for key, value in values.items()}, found, 8)
    assert {key for key in out if out[key] != found[key]} == ({name} if reaches else set())
    if reaches:
        own = out[name]
        # the mean of eight logs is known three times as well as the next
        high = 3.6 * 1.2 ** (1.0 / 3.0)
        assert own.ci95 == pytest.approx((found[name].ci95[0], high))
        assert own.ci95_total == pytest.approx((found[name].ci95_total[0], high))
        assert own.sd == pytest.approx((high - own.ci95[0]) / 4.0)
    words = [f"logs fitted alone have a (1 of {len(found)} parameters) elsewhere: a at 3.6"]
    assert all(typed(plain(one), Flag, known=True) == one for one in flags)
    assert [(one.code, one.message) for one in flags] == ([("logs_apart", words[0])] if reaches else [])


def test_a_fit_without_draws_keeps_its_values_and_identifies_none() -> None:
    fit = specimen_fit()
    bare = verdict.unsampled(fit, ValueError("too few draws"))
    assert [one.value for one in bare.parameters] == [one.value for one in fit.parameters]
    assert not any(one.identified for one in bare.parameters)
    words = "no posterior could be sampled"
    flag = Flag("sampler_not_converged", f"{words}: standard errors only", {"reason": "too few draws"})
    assert bare.flags == (*fit.flags, flag)
    assert bare.parameters[0].detail["withheld"] == words


def test_what_is_withheld_is_not_identified_and_says_why() -> None:
    parameters, (flag,) = withheld(tissue().parameters, ("static_1_N_per_mm",), "the value lies outside it")
    first, *others = parameters
    assert not first.identified
    assert first.value == OPTIMUM[0]
    assert first.as_json()["ci95"] is None
    assert all(one.identified for one in others)
    assert flag.code == "interval_withheld"
    assert "the value lies outside it" in flag.message
    assert withheld(tissue().parameters, (), "") == (tissue().parameters, ())


def test_an_interval_at_an_active_bound_includes_it():
    """Of highest density: from the bound where draws are densest there; central elsewhere, and for times."""
    rng = np.random.default_rng(2)
    near = np.abs(rng.standard_normal(20_000))
    far = 4.0 + rng.standard_normal(20_000)
    far = far[far > 0.0]
    found = interval95({"stiffness_0_N_per_mm": near, "static_1_N_per_mm": far, "relaxation_time_s": near})
    assert found["stiffness_0_N_per_mm"] == pytest.approx((0.0, 1.96), abs=0.04)
    assert found["static_1_N_per_mm"] == pytest.approx((2.04, 5.96), abs=0.06)
    assert found["relaxation_time_s"][0] == pytest.approx(0.0313, abs=0.01)


CLOSED = ProfileInterval(-1.0, -0.8, False, False)
AGREE = {"agree": True, "relative_difference": 0.0, "lm_converged": True}


def flags(
    *, tau=0.5, stiffness=30.0, interval=CLOSED, bounded=False, step=0.01, speeds=((1.0,), (5.0,)), hold=True,
    sigma=0.1, acf=0.0, optimisers=AGREE, missing=(), slope=None, duration=30.0,
):  # fmt: skip
    parameters = tuple(
        Estimate(name, name, "s", None if name in missing else 1.0, None, name not in missing)
        for name in ("relaxation_time_s", "viscosity_N_s_per_mm")
    )
    tissue = SimpleNamespace(
        model=MODEL, theta=np.array([20.0, -1.0, 0.3, stiffness, tau]), intervals=(interval,),
        bounded=bounded, parameters=parameters,
    )  # fmt: skip
    if slope is not None:
        tissue.model = kelvin_voigt(branches=1, stiffness_degree=1, depth_mm=4.0)
        tissue.theta = np.array([20.0, -1.0, 0.3, stiffness, slope, tau])
    facts = [
        SimpleNamespace(speeds_mm_s=one, depth_mm=4.0, has_hold=hold, step_s=step, duration_s=duration)
        for one in speeds
    ]
    trials = [SimpleNamespace(residual_acf1=acf) for _ in speeds]
    found = verdict.specimen_flags(tissue, facts, trials, sigma_N=sigma, optimisers=optimisers)
    return {flag.code: flag for flag in found}


APART = {"agree": False, "relative_difference": -0.01, "lm_converged": True}
ONE_SPEED = ((2.0,), (2.1,))


@pytest.mark.parametrize(
    ("given", "code", "values"),
    [
        ({"missing": ("viscosity_N_s_per_mm",)}, "not_identified", {"names": ["viscosity_N_s_per_mm"]}),
        ({"step": 0.26}, "tau_below_resolution", {"step_s": 0.26}),
        ({"tau": 0.1}, "compliance_unknown", {"tau_s": 0.1}),
        ({"duration": 1.4}, "tau_exceeds_window", {"branch": 1, "tau_s": 0.5, "window_length_s": 1.4}),
        ({"speeds": ONE_SPEED, "hold": False}, "single_speed", {}),
        ({"bounded": True}, "bound_active", {}),
        ({"optimisers": APART}, "optimisers_disagree", {"relative_difference": -0.01}),
        ({"optimisers": AGREE | {"lm_converged": False}}, "not_converged", {}),
        ({"acf": 0.6}, "residual_correlated", {"residual_acf1": 0.6}),
    ],
)
def test_a_flag_has_the_number_that_says_so(given, code, values):
    found = flags(**given)[code].values
    assert {name: found[name] for name in values} == values


@pytest.mark.parametrize(
    ("given", "code"),
    [
        ({"step": 0.24}, "tau_below_resolution"),
        ({"speeds": ONE_SPEED}, "single_speed"),
        ({"speeds": ((2.0,), (4.0,)), "hold": False}, "single_speed"),
        ({"optimisers": AGREE | {"agree": None}}, "optimisers_disagree"),
        ({"acf": 0.4}, "residual_correlated"),
        ({"duration": 1.6}, "tau_exceeds_window"),
        # the end of what was seen is said already
        ({"duration": 1.4, "interval": ProfileInterval(-1.0, 2.6, False, True)}, "tau_exceeds_window"),
    ],
)
def test_short_of_its_limit_there_is_no_flag(given, code):
    assert flags() == {}
    assert code not in flags(**given)


@pytest.mark.parametrize(("open_low", "word"), [(True, "shortest"), (False, "longest")])
def test_an_open_interval_says_at_which_end(open_low, word):
    interval = ProfileInterval(np.log(0.01), np.log(9.0), open_low, not open_low)
    found = flags(interval=interval)["interval_open"]
    assert word in found.message
    assert (found.values["low_s"], found.values["high_s"]) == pytest.approx((0.01, 9.0))


def test_amplitude_against_its_noise():
    """A = K v tau (1 - exp(-d / (v tau))) of the fastest ramp, against 3 sigma sqrt(8 h / tau)."""
    amplitude = 30.0 * 2.5 * -np.expm1(-4.0 / 2.5)
    need = amplitude / (3.0 * np.sqrt(8.0 * 0.01 / 0.5))
    found = flags(sigma=1.01 * need)["amplitude_small"]
    assert found.values["amplitude_N"] == pytest.approx(amplitude)
    assert found.values["needed_N"] == pytest.approx(1.01 * amplitude)
    assert "amplitude_small" not in flags(sigma=0.99 * need)


def test_amplitude_of_a_stiffness_that_ends_at_zero():
    """K = 30 - 7.5 x has none at 4 mm; its force is largest on the way, where its slope is none."""
    length = 5.0 * 0.5
    on_the_way = brentq(lambda x: (4.0 - x) * np.exp(-x / length) + length * np.expm1(-x / length), 0.1, 3.9)
    amplitude = 7.5 * (4.0 - on_the_way) * length * -np.expm1(-on_the_way / length)
    need = amplitude / (3.0 * np.sqrt(8.0 * 0.01 / 0.5))
    found = flags(sigma=1.01 * need, slope=-7.5)["amplitude_small"]
    assert found.values["amplitude_N"] == pytest.approx(amplitude, rel=1e-3)
    assert "amplitude_small" not in flags(sigma=0.99 * need, slope=-7.5)


@pytest.mark.parametrize(
    ("sigma", "said"), [(0.30, "3 times the noise"), (0.099, "as correlated noise would")]
)
def test_a_residual_of_the_size_of_the_noise_is_not_said_to_exceed_it(sigma, said):
    noise = SimpleNamespace(discrepant=True, measured_N=0.1, sigma_N=sigma, samples_per_independent=4.0)
    (flag,) = verdict.discrepancy_flags(noise, SimpleNamespace(range=0.01))
    assert said in flag.message


@pytest.mark.parametrize(("share", "codes"), [(4e-8, []), (0.02, ["discrepancy"])])
def test_what_rounding_leaves_of_a_log_without_noise_is_no_discrepancy(share, codes):
    noise = NoiseFit("white", 100.0 * share, 0.0, 0.001, measured_N=1e-12, samples_per_independent=1.1)
    assert [one.code for one in verdict.discrepancy_flags(noise, Nrmsd(share, share, 100.0 * share))] == codes
