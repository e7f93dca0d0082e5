"""Curves come back exactly, or are refused."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import h5py
import numpy as np
import pytest
from fit_factory import specimen_fit

from tissueid.errors import BundleError
from tissueid.store.curves import TrialCurve, curves_of_fits, load_curves, write_curves


def test_curves_come_back_exactly_and_in_order(tmp_path: Path) -> None:
    expected = curves_of_fits(
        [specimen_fit("a", trials=2, samples=50, sheet="Blatt 1"), specimen_fit("b", trials=1)]
    )
    write_curves(expected, tmp_path / "curves.h5")
    actual = load_curves(tmp_path / "curves.h5")
    assert [(c.specimen, c.path, c.sheet) for c in actual] == [
        (c.specimen, c.path, c.sheet) for c in expected
    ]
    for one, other in zip(actual, expected, strict=True):
        for name in ("time_s", "depth_mm", "force_N", "model_N", "fitted"):
            assert np.array_equal(getattr(one.curve, name), getattr(other.curve, name)), name


def test_no_curves_at_all_come_back_as_none(tmp_path: Path) -> None:
    write_curves([], tmp_path / "curves.h5")
    assert load_curves(tmp_path / "curves.h5") == ()


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "curves.h5"
    write_curves(curves_of_fits([specimen_fit()]), path)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(BundleError, match="cannot be read as curves"):
        load_curves(path)


def test_residuals_come_back_exactly_and_older_files_have_none(tmp_path: Path) -> None:
    curves = list(curves_of_fits([specimen_fit("a", trials=3, samples=80)]))
    without = TrialCurve(curves[1].specimen, curves[1].path, curves[1].sheet, curves[1].curve)
    expected = [curves[0], without, curves[2]]
    write_curves(expected, tmp_path / "curves.h5")
    actual = load_curves(tmp_path / "curves.h5")
    assert actual[1].residual is None
    for place in (0, 2):
        one, other = actual[place].residual, expected[place].residual
        for name in (field.name for field in fields(other)):
            assert np.array_equal(getattr(one, name), getattr(other, name)), name
    write_curves([without], tmp_path / "old.h5")
    with h5py.File(tmp_path / "old.h5") as file:
        assert "residual" not in file


def test_residuals_that_do_not_match_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "curves.h5"
    write_curves(curves_of_fits([specimen_fit(trials=2, samples=80)]), path)
    with h5py.File(path, "r+") as file:
        del file["residual/lags"]
        file["residual/lags"] = np.zeros(2, dtype=int)
    with pytest.raises(BundleError, match="residuals do not match"):
        load_curves(path)
