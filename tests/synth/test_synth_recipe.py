"""Recipes: named protocols, TOML, statistics of what is drawn."""

from dataclasses import replace

import numpy as np
import pytest

from tissueid.errors import InputError, UsageError
from tissueid.synth import (
    RECIPES,
    Branch,
    Hold,
    Log,
    Move,
    Recipe,
    as_trials,
    dump_recipe,
    load_recipe,
    recipe,
    simulate,
)

SHORT = Log("hold", (Move(2.0, 500.0), Hold(1.0)))


@pytest.mark.parametrize(
    ("name", "rate_Hz", "logs", "samples"),
    [
        ("paper-a-30", 1000.0, 30, 571_614),
        ("paper-a-30", 100.0, 30, 57_162),
        ("paper-a-30-k1", 1000.0, 30, 571_614),
        # sum over logs of ceil(T rate): 3 x 65,738 in ramps + 124,800 in holds
        ("paper-a-22", 1000.0, 22, 322_014),
    ],
)
def test_named_protocol_has_its_number_of_logs_and_samples(name, rate_Hz, logs, samples):
    drawn = simulate(replace(recipe(name), rate_Hz=rate_Hz), rng=np.random.default_rng(0))
    assert len(drawn) == logs
    assert sum(log.time_s.size for log in drawn) == samples


def test_named_protocols_carry_the_stated_truth():
    plain, growing = recipe("paper-a-30"), recipe("paper-a-30-k1")
    assert plain.branches == (Branch((63.62,), 0.021),)
    assert growing.branches == (Branch((63.62, 10.0), 0.021),)
    assert plain.static == growing.static == (20.0, -1.2, 0.35)
    assert plain.sigma_N == 1.0


def test_unknown_name_lists_the_known_ones():
    with pytest.raises(UsageError, match="paper-a-30"):
        recipe("paper-b")


@pytest.mark.parametrize("name", sorted(RECIPES))
def test_recipe_survives_its_toml(tmp_path, name):
    changed = replace(
        RECIPES[name], specimen='a "quoted" \\ name', ar1_phi=0.9, ar1_sigma_N=0.3, compression_sign=-1
    )
    path = tmp_path / "recipe.toml"
    path.write_text(dump_recipe(changed), encoding="utf-8")
    assert load_recipe(path) == changed


def test_recipe_without_branches_survives_its_toml(tmp_path):
    path = tmp_path / "recipe.toml"
    elastic = Recipe("elastic", (SHORT,), branches=())
    path.write_text(dump_recipe(elastic), encoding="utf-8")
    assert load_recipe(path) == elastic


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("name = ", "is not TOML"),
        ('name = "x"\nlogs = []', "at least one log"),
        ('name = "x"\nsigma = 1\nlogs = []', "unknown key 'sigma'"),
        ('name = "x"', "logs"),
        ('name = "x"\nrate_Hz = 0.0\n[[logs]]\nname = "a"\nmoves = [{hold_s = 1.0}]', "rate_Hz is 0.0"),
        (
            'name = "x"\n[[logs]]\nname = "a"\nmoves = [{to_mm = 1.0, speed_mm_min = 0.0}]',
            "speed or duration",
        ),
    ],
)
def test_bad_recipe_is_refused_with_its_reason(tmp_path, text, reason):
    path = tmp_path / "recipe.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=reason):
        load_recipe(path)


def test_missing_recipe_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="can't be read"):
        load_recipe(tmp_path / "none.toml")


def test_white_noise_has_its_standard_deviation():
    log = simulate(Recipe("noise", (SHORT,), rate_Hz=50_000.0, sigma_N=0.3), rng=np.random.default_rng(5))[0]
    noise = log.force_N - log.force_clean_N
    n = noise.size
    assert noise.std() == pytest.approx(0.3, abs=4.0 * 0.3 / np.sqrt(2 * n))
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(0.0, abs=4.0 / np.sqrt(n))


def test_correlated_noise_is_stationary_with_its_correlation():
    phi, n = 0.9, 400
    settings = Recipe("ar1", (SHORT,), rate_Hz=1000.0, sigma_N=0.0, ar1_sigma_N=0.5, ar1_phi=phi)
    rng = np.random.default_rng(6)
    noise = np.array([(log := simulate(settings, rng=rng)[0]).force_N - log.force_clean_N for _ in range(n)])
    # each column is n independent draws
    assert noise[:, 0].std() == pytest.approx(0.5, abs=4.0 * 0.5 / np.sqrt(2 * n))
    assert noise[:, -1].std() == pytest.approx(0.5, abs=4.0 * 0.5 / np.sqrt(2 * n))
    lag_one = (noise[:, 1:] * noise[:, :-1]).mean() / (noise**2).mean()
    assert lag_one == pytest.approx(phi, abs=0.01)


def test_gains_scatter_with_the_stated_cv_and_median_one():
    n = 4000
    settings = Recipe("cv", (Log("r", (Move(0.5, 500.0),), repeats=n),), rate_Hz=100.0, cv_both=0.15)
    logs = simulate(settings, rng=np.random.default_rng(7))
    gain = np.array([log.truth["gain"] for log in logs])
    assert np.array_equal(gain, [log.truth["gain_stiffness"] for log in logs])
    assert gain.std() / gain.mean() == pytest.approx(0.15, rel=4.0 / np.sqrt(2 * n) * 1.1)
    assert np.median(gain) == pytest.approx(1.0, abs=4.0 * 1.2533 * 0.15 / np.sqrt(n))


def test_static_gain_leaves_the_branches_alone():
    quiet = Recipe("cv", (SHORT,), sigma_N=0.0, cv_static=0.3, static=(20.0,))
    log = simulate(quiet, rng=np.random.default_rng(8))[0]
    assert log.truth["gain_stiffness"] == 1.0
    # the hold has relaxed for 48 tau: only the static force is left
    assert log.force_N[-1] == pytest.approx(log.truth["gain"] * 40.0, rel=1e-12)


def test_contact_offsets_scatter_and_are_kept_in_the_truth():
    settings = Recipe(
        "offset", (Log("r", (Move(1.0, 500.0),), repeats=2000),), rate_Hz=100.0, contact_offset_sd_mm=0.1
    )
    offsets = [log.truth["contact_offset_mm"] for log in simulate(settings, rng=np.random.default_rng(9))]
    assert np.std(offsets) == pytest.approx(0.1, rel=4.0 / np.sqrt(4000))


def test_compression_sign_turns_displacement_and_force():
    plain = simulate(Recipe("s", (SHORT,)), rng=np.random.default_rng(1))[0]
    turned = simulate(Recipe("s", (SHORT,), compression_sign=-1), rng=np.random.default_rng(1))[0]
    assert np.array_equal(turned.displacement_mm, -plain.displacement_mm)
    assert np.array_equal(turned.force_N, -plain.force_N)


def test_same_seed_gives_the_same_numbers_and_another_does_not():
    def first(seed):
        return simulate(recipe("paper-a-hold-100Hz"), rng=np.random.default_rng(seed))[0].force_N

    assert np.array_equal(first(1), first(1))
    assert not np.array_equal(first(1), first(2))


def test_trials_carry_one_label_a_specimen_and_the_protocol():
    settings = Recipe("two", (SHORT,), specimens=2, specimen="S")
    trials = as_trials(simulate(settings, rng=np.random.default_rng(1)))
    assert [trial.specimen for trial in trials] == ["S-01", "S-02"]
    assert trials[0].protocol.speed_mm_s == pytest.approx(500.0 / 60.0)
    assert (trials[0].protocol.depth_mm, trials[0].protocol.hold_s) == (2.0, 1.0)
    assert as_trials(simulate(settings, rng=np.random.default_rng(1)), specimen="X")[0].specimen == "X"
    assert len({trial.name for trial in trials}) == 2
