"""A power of depth damped by the speed over that at contact: recovery, intervals, refusals."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from impact_logs import impact_logs

import tissueid as ti
from tissueid.errors import InputError
from tissueid.inference import logs
from tissueid.inference.channel_law import with_speed_ratio
from tissueid.inference.logs import LogHandle, speed_handles
from tissueid.inference.specimen import FitOptions
from tissueid.inference.window import fitted_log
from tissueid.model.grammar import candidates
from tissueid.pipeline import IdentifyOptions, identify
from tissueid.priors import CalibrationPrior, Priors
from tissueid.segment import SegmentOptions, segment
from tissueid.synth.recipe import Hold, Log, Move, Recipe
from tissueid.synth.simulate import as_trials

LAW = "power * impact"
TRUTH = {"c": 4.0, "n": 1.5, "e": 0.7}
RAMP = (Move(5.0, 100.0),)
HELD = (*RAMP, Hold(3.0))
RETURNED = (*HELD, Move(0.0, 100.0))
#: The simulated machine has no fault, and that is known.
KNOWN = {"skew_s": 1e-6, "force_filter_s": 1e-6, "frame_compliance_mm_per_N": 1e-7}
LOWER = {"force_filter_s": 0.0, "frame_compliance_mm_per_N": 0.0}
NO_FAULT = Priors(
    calibration={
        name: CalibrationPrior(0.0, sd, LOWER.get(name, -np.inf), stated=True) for name, sd in KNOWN.items()
    }
)
CORRELATED = {"rate_Hz": 200.0, "sigma_N": 0.2, "ar1_sigma_N": 0.3, "ar1_phi": 0.8}


def recorded(moves, *, seed=1, speeds=(1.0,), **recipe):
    """Trials of a program at multiples of its speed."""

    def faster(move, factor):
        return replace(move, speed_mm_min=move.speed_mm_min * factor) if isinstance(move, Move) else move

    program = tuple(Log(f"at{k}", tuple(faster(one, by) for one in moves)) for k, by in enumerate(speeds))
    plan = Recipe("law", program, **{"rate_Hz": 100.0, "sigma_N": 0.2, "contact_offset_mm": 1.0, **recipe})
    rng = np.random.default_rng(seed)
    return as_trials(impact_logs(plan, stiffness=4.0, exponent=1.5, restitution=0.7, rng=rng))


def fitted(moves, *, name=LAW, **given):
    return ti.fit(recorded(moves, **given), name, priors=NO_FAULT)


def rows(fit):
    return {one["symbol"]: one for one in fit.result.as_json()["parameters"]}


@pytest.mark.parametrize("speeds", [(1.0,), (1.0, 3.0)])
def test_noise_free_recordings_give_the_truth(speeds):
    for symbol, row in rows(fitted(RETURNED, speeds=speeds, sigma_N=0.0)).items():
        # the segmenter places the contact within a sample; offsets are fitted
        assert row["value"] == pytest.approx(TRUTH[symbol], rel=2e-3)


#: k, n and e with their standard errors, by a least-squares fit of every sample: Levenberg-Marquardt on ln k,
#: n, chi, contact points and readings in air, residuals whitened by an autoregression of their own.
BY_SAMPLES = (
    ({"seed": 1}, {"c": (3.9536, 0.0284), "n": (1.50654, 0.00383), "e": (0.70023, 0.00024)}),
    ({"seed": 2}, {"c": (4.0164, 0.0333), "n": (1.49758, 0.00429), "e": (0.70014, 0.00026)}),
    ({"seed": 1, **CORRELATED}, {"c": (3.9151, 0.1066), "n": (1.51095, 0.01419), "e": (0.69986, 0.00079)}),
    ({"seed": 2, **CORRELATED}, {"c": (3.9503, 0.1256), "n": (1.50654, 0.01631), "e": (0.70012, 0.00088)}),
)


@pytest.mark.parametrize(("given", "expected"), BY_SAMPLES)
def test_blocks_give_what_every_sample_gives(given, expected):
    found = rows(fitted(RETURNED, **given))
    for symbol, (value, stderr) in expected.items():
        # one estimate from two weightings of the same noise
        assert abs(found[symbol]["value"] - value) <= 2.0 * stderr, symbol
        assert 0.5 < found[symbol]["stderr"] / stderr < 2.0, symbol


def test_the_exact_law_is_the_same_force_by_another_number():
    printed, exact = (fitted(RETURNED, name=name) for name in (LAW, "power * impact-exact"))
    # the printed damping of e = 0.7 returns 0.683 of the speed
    assert rows(exact)["e"]["value"] == pytest.approx(0.683, abs=0.002)
    assert exact.result.nrmsd.range == pytest.approx(printed.result.nrmsd.range, rel=1e-3)


def test_a_ramp_alone_leaves_static_force_and_restitution_null():
    fit = fitted(RAMP, speeds=(1.0, 5.0))
    found = rows(fit)
    assert (found["c"]["value"], found["e"]["value"]) == (None, None)
    assert found["n"]["value"] == pytest.approx(1.5, abs=0.05)
    (flag,) = [one for one in fit.flags if one.code == "one_speed_ratio"]
    # 1 + chi = 1 + 8 * 0.3 / 3.5
    assert flag.values["loading"] == pytest.approx(4.0 * (1.0 + 2.4 / 3.5), rel=0.1)
    assert flag.values["slow_share"] < 0.02


def test_a_relaxing_law_is_compared_on_the_same_samples():
    fit = fitted(HELD, name=f"power * prony:1 | {LAW}")
    assert fit.result.model.name == LAW
    assert {row["model"] for row in fit.result.selection} == {LAW, "power * prony:1"}


def test_several_logs_are_left_out_and_the_next_is_predicted():
    trials = recorded(RETURNED, speeds=(1.0, 2.0, 3.0))
    fit = ti.fit(trials, f"{LAW} | kelvin-voigt", priors=NO_FAULT)
    assert fit.result.model.name == LAW
    scores = {row.get("model", "kelvin-voigt"): row["score"] for row in fit.result.selection}
    assert max(scores, key=scores.get) == LAW
    low, high = rows(ti.fit(trials, LAW, priors=NO_FAULT).sample(draws=200))["n"]["prediction95"]
    assert low < 1.5 < high


def test_an_exponent_that_noise_hides_or_that_ends_its_range_is_none():
    assert rows(fitted((Move(1.6, 20.0), Hold(1.0)), sigma_N=0.8))["n"]["value"] is None
    (trial,) = recorded(RETURNED)
    hold = {key: getattr(trial, key)[330:] for key in ("time_s", "displacement_mm", "force_N")}
    # a tool that leaves, read as one that comes
    turned = SegmentOptions(compression_sign=-1, force_sign=-1)
    assert rows(ti.fit(replace(trial, **hold), LAW, segment=turned))["n"]["value"] is None
    with pytest.raises(InputError, match="no move into the tissue"):
        ti.fit(replace(trial, **hold), LAW)


def test_it_is_put_together_in_python():
    assert ti.ContactModel(static="power", damping="impact").name == LAW
    with pytest.raises(ValueError, match="leave stiffness and relaxation out"):
        ti.ContactModel(static="power", relaxation="fung", damping="impact")


def test_a_record_that_no_speed_begins_is_refused_and_the_rest_goes_on(monkeypatch):
    (trial,) = recorded(RETURNED)
    still = replace(trial, displacement_mm=np.minimum.accumulate(-trial.displacement_mm))
    segmentation = segment(trial)
    log = fitted_log(trial, segmentation)
    assert with_speed_ratio(still, segmentation, log) is None
    handle = LogHandle(lambda: still, segmentation, log.without_samples(), contact_sd_mm=0.1)
    with pytest.raises(InputError, match="0 contacts begin at a speed"):
        speed_handles([handle], candidates(LAW))
    monkeypatch.setattr(logs, "with_speed_ratio", lambda *_: None)
    found = identify([trial], options=IdentifyOptions(fit=FitOptions(model=LAW)))
    assert [one.code for one in found.refused] == ["no_contact"]
    assert found.exit.code == 3


def test_a_second_contact_has_its_own_speed():
    moves = (Move(4.0, 100.0), Hold(1.0), Move(0.0, 100.0), Hold(0.5), Move(5.0, 300.0), Hold(1.0))
    for symbol, row in rows(fitted(moves, seed=3)).items():
        assert abs(row["value"] - TRUTH[symbol]) <= 4.0 * row["stderr"], symbol


def test_rounding_of_the_records_begins_no_second_contact_in_a_hold():
    rng = np.random.default_rng(3)
    (trial,) = recorded(RETURNED, sigma_N=0.0)
    found = segment(trial)
    log = fitted_log(trial, found, whole=True)
    exact = with_speed_ratio(trial, found, log)
    for _ in range(10):
        rounded = trial.displacement_mm * (1.0 + 1e-14 * rng.standard_normal(trial.time_s.size))
        again = with_speed_ratio(replace(trial, displacement_mm=rounded), found, log)
        # a hold has no speed, whatever the sign of its rounding
        np.testing.assert_allclose(again.data.speed_ratio, exact.data.speed_ratio, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("given", [{}, CORRELATED], ids=["white", "white+ar1"])
def test_intervals_hold_the_truth_as_often_as_they_say(given):
    hit, known, off = (dict.fromkeys(TRUTH, 0) for _ in range(3))
    for seed in range(40):
        fit = fitted(RETURNED, seed=100 + seed, **given).sample(draws=400, seed=seed)
        for symbol, row in rows(fit).items():
            low, high = row["ci95_total"]
            known[symbol] += 1
            hit[symbol] += low <= TRUTH[symbol] <= high
            off[symbol] += ((row["value"] - TRUTH[symbol]) / row["sd"]) ** 2
    for symbol in TRUTH:
        spread = np.sqrt(off[symbol] / known[symbol])
        sys.stdout.write(f"\n{given} {symbol}: {hit[symbol]} of {known[symbol]}, z {spread:.2f}")
        assert known[symbol] == 40
        # binomial: three standard deviations of 95 % in 40 are 10.3 %
        assert hit[symbol] >= 40 * (0.95 - 0.103)
