"""A load cell whose zero is off, in a record that starts at the surface (synthetic)."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.segment import segment
from tissueid.trial import Trial


def recording(zero_N: float) -> Trial:
    """1 s at rest on the surface, a ramp of 2 mm in 1 s, 10 s hold; 100 Hz, 10 N/mm, noise 0.01 N."""
    time = np.arange(1200) * 0.01
    depth = 2.0 * np.clip(time - 1.0, 0.0, 1.0)
    noise = np.random.default_rng(3).normal(0.0, 0.01, time.size)
    return Trial("synthetic", time, depth, 10.0 * depth + zero_N + noise)


def test_a_negative_force_at_rest_is_the_zero_of_the_load_cell() -> None:
    contact = segment(recording(-5.0)).contact
    assert contact is not None
    # mean of 100 samples of noise 0.01 N: sd 0.001 N
    assert contact.baseline_N == pytest.approx(-5.0, abs=0.005)
    assert abs(contact.displacement_mm) <= 4.0 * contact.sd_mm


def test_a_positive_force_at_rest_stays_a_preload() -> None:
    segmentation = segment(recording(5.0))
    assert segmentation.contact is not None
    assert segmentation.contact.baseline_N == 0.0
    assert "preload" in {flag.code for flag in segmentation.flags}
