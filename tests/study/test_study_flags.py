"""Flags that need several logs of a specimen together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from fit_factory import specimen_fit

from tissueid.between_logs import order_effect, repeated_sites, spread_flags
from tissueid.result import TrialFit


def logs(gains: Sequence[float]) -> list[TrialFit]:
    (one,) = specimen_fit(trials=1).trials
    return [replace(one, path=f"run_{i}.csv", gain=gain) for i, gain in enumerate(gains, start=1)]


def test_logs_that_differ_much_are_asked_after_and_their_order_is_that_of_the_files():
    assert spread_flags(logs([1.0, 1.04, 0.97, 1.01])) == []
    assert spread_flags(logs([1.0])) == []
    (flag,) = spread_flags(logs([0.7, 1.0, 1.3]))
    assert flag.values["sd_ln_gain"] == pytest.approx(np.log([0.7, 1.0, 1.3]).std(ddof=1))
    assert (flag.values["lowest"], flag.values["highest"]) == (0.7, 1.3)
    assert "run_1.csv" in flag.message
    assert "run_3.csv" in flag.message
    (one,) = logs([1.0])
    (flag,) = spread_flags([replace(one, path=f"run_{k}.csv", time_ratio=k) for k in (1.4, 1.0, 0.6)])
    assert flag.code == "relaxation_spread"
    assert flag.message.startswith(
        "relaxation time differs by 43 % (sd) between logs, from 0.60 (run_0.6.csv"
    )
    (flag,) = order_effect(logs([1.0, 0.95, 0.9, 0.85]), [None] * 4)
    assert "from file 1 to file 4" in flag.message
    assert order_effect(logs([1.0, 0.9, 0.8]), [1, 2, 3]) == []
    assert order_effect(logs([1.0, 1.0, 1.0, 1.0]), [1, 2, 3, 4]) == []


def test_stiffness_that_follows_the_order_is_said_with_its_change():
    rng = np.random.default_rng(31)
    runs = list(range(1, 11))
    falling = np.exp(-0.02 * np.array(runs) + 0.005 * rng.standard_normal(10))
    (flag,) = order_effect(logs(falling), runs)
    # nine steps of -2 %, each known to 0.5 % over 9^0.5
    assert flag.values["change"] == pytest.approx(np.expm1(-0.18), abs=0.01)
    assert flag.values["p"] < 1e-6
    assert "falls by" in flag.message
    # the order is that of the runs, not of the files
    (same,) = order_effect(logs(falling[::-1]), runs[::-1])
    assert same.values["change"] == pytest.approx(flag.values["change"])


def test_scatter_is_no_order_effect_more_often_than_the_chance_it_states():
    rng = np.random.default_rng(32)
    found = sum(
        bool(order_effect(logs(np.exp(0.05 * rng.standard_normal(8))), list(range(8)))) for _ in range(400)
    )
    # p < 0.01: 4 expected, 13 is the upper 99.99 % bound of a binomial of 400
    assert found <= 13


def test_a_first_test_that_is_stiffer_than_all_others_is_said():
    gains = [1.2, 1.0, 1.01, 0.99, 1.005, 0.995]
    (flag,) = order_effect(logs(gains), [None] * 6)
    assert flag.message.startswith("the first file is 20.0 % stiffer than the other 5")
    assert flag.values["first"]
    rng = np.random.default_rng(33)
    found = sum(
        bool(order_effect(logs(np.exp(0.05 * rng.standard_normal(6))), [None] * 6)) for _ in range(400)
    )
    # two tests of p < 0.01: 8 expected, 19 is the upper 99.99 % bound of a binomial of 400
    assert found <= 19


@pytest.mark.parametrize(
    ("rows", "sites", "rest"),
    [
        ([{"site": "A"}, {"site": "B"}], None, None),
        ([{}, {}], None, None),
        ([{"site": "A", "rest_s": 60.0}, {"site": "A", "rest_s": 30.0}, {"site": "B"}], ["A"], 30.0),
        ([{"site": "A"}, {"site": "A"}], ["A"], None),
    ],
)
def test_a_site_that_was_tested_twice_is_named_with_its_rest(rows, sites, rest):
    flags = repeated_sites(logs([1.0] * len(rows)), rows)
    if sites is None:
        assert flags == []
        return
    (flag,) = flags
    assert flag.values["sites"] == sites
    assert flag.values["times"] == [2]
    assert flag.values.get("shortest_rest_s") == rest
