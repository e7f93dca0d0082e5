"""The budget read off draws: shares against a linear dependence that is known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tissueid.inference.reported import TOTAL, uncertainty_budget

NAMES = (
    "ln_tau_1",
    "frame_compliance_mm_per_N",
    "skew_s",
    "force_filter_s",
    "linear_1",
    "contact",
    "ln_sigma",
)
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
    assert set(rows) == {"noise", TOTAL, *PARTS}
    whole = sum(one**2 for one in PARTS.values()) + NOISE**2
    for name, part in {**PARTS, "noise": NOISE}.items():
        # 40,000 draws know a covariance to half a per cent of the whole
        assert rows[name].share == pytest.approx(part**2 / whole, abs=0.02), name
        assert rows[name].sd == pytest.approx(abs(part), abs=0.15), name
    assert rows[TOTAL].share is None
    assert rows[TOTAL].sd == pytest.approx(value.std(), rel=1e-9)
    assert sum(row.share for row in rows.values() if row.share is not None) == pytest.approx(1.0)


def test_every_parameter_has_its_rows_noise_first_and_the_total_last():
    vectors, gains, value = drawn(500)
    rows = uncertainty_budget(target(), vectors, gains, {"a": value, "b": 2.0 * value})
    assert [row.parameter for row in rows] == ["a"] * 8 + ["b"] * 8
    assert [row.source for row in rows][::8] == ["noise", "noise"]
    assert [row.source for row in rows][7::8] == [TOTAL, TOTAL]
    assert rows[8 + 3].sd == pytest.approx(2.0 * rows[3].sd)


def test_what_is_held_is_no_source():
    free = np.array([name not in {"contact", "skew_s"} for name in NAMES])
    vectors, gains, value = drawn(500)
    sources = {row.source for row in uncertainty_budget(target(free), vectors, gains, {"a": value})}
    assert sources == {"noise", "frame", "force filter", "force gain", "displacement gain", TOTAL}


def test_what_is_known_exactly_has_no_share():
    vectors, gains, value = drawn(2_000)
    vectors[:, 1], gains[:, 0] = 0.0, 1.0
    rows = {row.source: row for row in uncertainty_budget(target(), vectors, gains, {"a": value})}
    assert rows["frame"].share == pytest.approx(0.0, abs=1e-12)
    assert rows["force gain"].share == pytest.approx(0.0, abs=1e-12)
    still = {row.source: row for row in uncertainty_budget(target(), vectors, gains, {"a": np.ones(2_000)})}
    assert still[TOTAL].sd == 0.0
    assert all(row.sd == 0.0 for row in still.values())
