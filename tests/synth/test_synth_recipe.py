"""Recipes, their logs, and the sets they make on disk."""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tissueid.errors import InputError, UsageError
from tissueid.synth import (
    DIALECTS,
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
    write_set,
)

SHORT = Log("hold", (Move(2.0, 500.0), Hold(1.0)))


@pytest.mark.parametrize(
    ("name", "rate_Hz", "logs", "samples"),
    [
        ("paper-a-30", 100.0, 30, 57_162),
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
    with pytest.raises(UsageError, match="paper-a-30"):
        recipe("paper-b")


@pytest.mark.parametrize("known", [*RECIPES.values(), Recipe("elastic", (SHORT,), branches=())])
def test_recipe_survives_its_toml(tmp_path, known):
    changed = replace(known, specimen='a "quoted" \\ name', ar1_phi=0.9, ar1_sigma_N=0.3, compression_sign=-1)
    path = tmp_path / "recipe.toml"
    path.write_text(dump_recipe(changed), encoding="utf-8")
    assert load_recipe(path) == changed


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, "can't be read"),
        ("name = ", "is not TOML"),
        ('name = "x"\nlogs = []', "at least one log"),
        ('name = "x"\nsigma = 1\nlogs = []', "unknown key 'sigma'"),
        ('name = "x"', "logs"),
        ('name = "x"\n[[logs]]\nname = "a"\nmoves = []', "at least one move"),
        ('name = "x"\nrate_Hz = 0.0\n[[logs]]\nname = "a"\nmoves = [{hold_s = 1.0}]', "rate_Hz is 0.0"),
        (
            'name = "x"\n[[logs]]\nname = "a"\nmoves = [{to_mm = 1.0, speed_mm_min = 0.0}]',
            "speed or duration",
        ),
        (
            'name = "x"\n' + "[[logs]]\nname = 'a'\nmoves = [{to_mm = 1.0, speed_mm_min = 60.0}]\n" * 2,
            "two logs have one name",
        ),
    ],
)
def test_bad_recipe_is_refused_with_its_reason(tmp_path, text, reason):
    path = tmp_path / "recipe.toml"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=reason):
        load_recipe(path)


@pytest.mark.parametrize("to_mm", [0.0, 1.0])
def test_a_log_of_less_than_two_samples_is_refused(to_mm):
    short = Recipe("short", (Log("a", (Move(to_mm, 60.0),)),), rate_Hz=0.5, force_filter_s=0.1)
    with pytest.raises(UsageError, match="less than two samples"):
        simulate(short, rng=np.random.default_rng(0))


def test_noise_is_white_or_stationary_with_its_correlation():
    log = simulate(Recipe("noise", (SHORT,), rate_Hz=50_000.0, sigma_N=0.3), rng=np.random.default_rng(5))[0]
    noise = log.force_N - log.force_clean_N
    n = noise.size
    assert noise.std() == pytest.approx(0.3, abs=4.0 * 0.3 / np.sqrt(2 * n))
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(0.0, abs=4.0 / np.sqrt(n))
    phi, n = 0.9, 400
    settings = Recipe("ar1", (SHORT,), rate_Hz=1000.0, sigma_N=0.0, ar1_sigma_N=0.5, ar1_phi=phi)
    rng = np.random.default_rng(6)
    noise = np.array([(log := simulate(settings, rng=rng)[0]).force_N - log.force_clean_N for _ in range(n)])
    # each column is n independent draws
    assert noise[:, 0].std() == pytest.approx(0.5, abs=4.0 * 0.5 / np.sqrt(2 * n))
    assert noise[:, -1].std() == pytest.approx(0.5, abs=4.0 * 0.5 / np.sqrt(2 * n))
    lag_one = (noise[:, 1:] * noise[:, :-1]).mean() / (noise**2).mean()
    assert lag_one == pytest.approx(phi, abs=0.01)


def test_gains_and_contacts_scatter_as_stated_and_are_kept_in_the_truth():
    n = 4000
    many = Recipe("cv", (Log("r", (Move(0.5, 500.0),), repeats=n),), rate_Hz=100.0, cv_both=0.15)
    logs = simulate(replace(many, contact_offset_sd_mm=0.1), rng=np.random.default_rng(7))
    gain = np.array([log.truth["gain"] for log in logs])
    assert np.array_equal(gain, [log.truth["gain_stiffness"] for log in logs])
    assert gain.std() / gain.mean() == pytest.approx(0.15, rel=4.0 / np.sqrt(2 * n) * 1.1)
    assert np.median(gain) == pytest.approx(1.0, abs=4.0 * 1.2533 * 0.15 / np.sqrt(n))
    offsets = [log.truth["contact_offset_mm"] for log in logs]
    assert np.std(offsets) == pytest.approx(0.1, rel=4.0 / np.sqrt(2 * n))
    # a static gain leaves the branches alone
    quiet = Recipe("cv", (SHORT,), sigma_N=0.0, cv_static=0.3, static=(20.0,))
    (log,) = simulate(quiet, rng=np.random.default_rng(8))
    assert log.truth["gain_stiffness"] == 1.0
    # the hold has relaxed for 48 tau: only the static force is left
    assert log.force_N[-1] == pytest.approx(log.truth["gain"] * 40.0, rel=1e-12)


def test_logs_have_the_sign_the_label_and_the_protocol_of_their_recipe():
    plain = simulate(Recipe("s", (SHORT,)), rng=np.random.default_rng(1))[0]
    turned = simulate(Recipe("s", (SHORT,), compression_sign=-1), rng=np.random.default_rng(1))[0]
    assert np.array_equal(turned.displacement_mm, -plain.displacement_mm)
    assert np.array_equal(turned.force_N, -plain.force_N)
    settings = Recipe("two", (SHORT,), specimens=2, specimen="S")
    trials = as_trials(simulate(settings, rng=np.random.default_rng(1)))
    assert [trial.specimen for trial in trials] == ["S-01", "S-02"]
    assert trials[0].protocol.speed_mm_s == pytest.approx(500.0 / 60.0)
    assert (trials[0].protocol.depth_mm, trials[0].protocol.hold_s) == (2.0, 1.0)
    assert as_trials(simulate(settings, rng=np.random.default_rng(1)), specimen="X")[0].specimen == "X"
    assert len({trial.name for trial in trials}) == 2


COMMITTED = Path(__file__).parents[2] / "datasets_synthetic"
SMALL = Recipe(
    "small", (Log("hold", (Move(50.0, 6000.0), Hold(0.5))),), rate_Hz=100.0, static=(60.0,), sigma_N=2.0
)


def parsed(data: bytes, dialect) -> np.ndarray:
    """Numbers of an export by the plainest reading of its grammar."""
    lines = data.decode(dialect.encoding).split(dialect.newline)
    names = lines.index(dialect.delimiter.join(dialect.names))
    rows = []
    for line in lines[names + 2 : -1]:
        cells = re.findall(r'"([^"]*)"', line) if dialect.quoted else line.split(dialect.delimiter)
        plain = (cell.replace(dialect.thousands, "") if dialect.thousands else cell for cell in cells)
        rows.append([float(cell.replace(dialect.decimal, ".")) for cell in plain])
    return np.array(rows)


def is_plain(dialect) -> bool:
    """Names, units and rows of the three channels in their order, with nothing above, below or between."""
    shape = (dialect.order, dialect.columns, dialect.results, dialect.wrapped, dialect.unit_in_names)
    return shape == ((0, 1, 2), (), "", False, False) and dialect.units_row and not dialect.lead + dialect.end


@pytest.mark.parametrize("name", sorted(name for name, dialect in DIALECTS.items() if is_plain(dialect)))
def test_each_dialect_prints_the_simulated_numbers(tmp_path, name):
    write_set(SMALL, tmp_path, seed=4, dialect=name)
    log = simulate(SMALL, rng=np.random.default_rng(4))[0]
    expected = np.column_stack([log.time_s, log.displacement_mm, log.force_N])
    data = (tmp_path / "hold-1.csv").read_bytes()
    # five decimals are printed
    np.testing.assert_allclose(parsed(data, DIALECTS[name]), expected, atol=0.5e-5 * (1 + 1e-6))
    if DIALECTS[name].thousands:
        assert f'"3{DIALECTS[name].thousands}0'.encode(DIALECTS[name].encoding) in data


def test_a_set_reads_as_documented_and_holds_its_hashes_truth_and_recipe(tmp_path):
    write_set(SMALL, tmp_path, seed=4)
    lines = (tmp_path / "hold-1.csv").read_bytes().split(b"\r\n")
    assert lines[0] == b'Text Inputs : Specimen label,"synthetic"'
    assert lines[2] == b'Test : Rate 1,"6000.00000",mm/min'
    assert lines[3:6] == [b"", b"Time,Extension,Load", b"(sec),(mm),(N)"]
    assert lines[6].startswith(b"0.00000,0.00000,")
    assert lines[-1] == b""
    # written again it is the same set
    for _ in range(2):
        written = write_set(replace(SMALL, cv_both=0.1), tmp_path, seed=4)
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in written}
    sums = dict(reversed(line.split("  ")) for line in (tmp_path / "SHA256SUMS").read_text().splitlines())
    assert set(sums) == {"hold-1.csv", "recipe.toml", "truth.json"}
    for name, digest in sums.items():
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == digest
    assert load_recipe(tmp_path / "recipe.toml") == replace(SMALL, cv_both=0.1)
    truth = json.loads((tmp_path / "truth.json").read_text())
    log = simulate(replace(SMALL, cv_both=0.1), rng=np.random.default_rng(4))[0]
    assert truth["logs"][0]["gain"] == pytest.approx(log.truth["gain"], rel=1e-11)
    assert truth["seed"] == 4


def test_an_unknown_dialect_and_a_directory_with_something_else_in_it_are_refused(tmp_path):
    (tmp_path / "mine.csv").write_text("1,2,3")
    with pytest.raises(UsageError, match=r"mine\.csv"):
        write_set(SMALL, tmp_path, seed=4)
    with pytest.raises(UsageError, match="semicolon"):
        write_set(SMALL, tmp_path, seed=4, dialect="klingon")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.csv"]


@pytest.mark.parametrize("name", ["paper-a-22-250Hz", "paper-a-30-10Hz", "paper-a-hold-100Hz", "rupture-18"])
def test_committed_set_is_what_the_generator_writes(tmp_path, name):
    truth = json.loads((COMMITTED / name / "truth.json").read_text())
    write_set(recipe(name), tmp_path, seed=truth["seed"], dialect=truth["dialect"])
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        path.name for path in (COMMITTED / name).iterdir()
    )
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (COMMITTED / name / path.name).read_bytes(), path.name
