"""Curves and draws come back as they were written, and belong to the set they were written into."""

from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from fit_factory import identification, specimen_fit, write_results
from posterior_factory import sampled
from set_writer import commit

from tissueid.errors import BundleError
from tissueid.result import ResidualSummary
from tissueid.store.curves import curves_of_fits, load_curves, write_curves
from tissueid.store.files import POSTERIORS
from tissueid.store.hdf5 import new_file
from tissueid.store.outputs import OutputSet
from tissueid.store.posteriors import StoredPosterior, load_posteriors, posteriors_of_fits, put_posteriors
from tissueid.store.results import output_problems, read_results

FITS = (
    sampled(specimen_fit("a", trials=2, samples=50)),
    specimen_fit("b", trials=1, samples=50),
    sampled(specimen_fit("c", trials=1, samples=70, sheet="S 1"), total=False, seed=4),
)


def write_posteriors(posteriors: Iterable[StoredPosterior], path: Path) -> None:
    with new_file(path) as file:
        put_posteriors(file, posteriors)


def test_draws_chains_densities_and_bands_come_back(tmp_path):
    first, last = posteriors_of_fits(FITS)
    expected = [replace(first, log_density=first.chain.sum(axis=2)), last]
    write_posteriors(expected, tmp_path / "p.h5")
    actual = load_posteriors(tmp_path / "p.h5")
    assert [one.specimen for one in actual] == ["a", "c"]
    for before, after in zip(expected, actual, strict=True):
        for name in ("theta_names", "chain_names", "draws", "draws_total", "chain", "log_density"):
            assert np.array_equal(getattr(after, name), getattr(before, name)), name
        assert list(after.bands) == list(before.bands)
        for trial, band in before.bands.items():
            # kept as 32-bit floats: 24 bits of mantissa
            assert after.bands[trial] == pytest.approx(band, rel=2.0**-24)
    assert (actual[1].draws_total, actual[1].log_density) == (None, None)


def test_a_damaged_file_is_refused_with_the_way_out(tmp_path):
    path, (before, _) = tmp_path / "p.h5", posteriors_of_fits(FITS)
    with pytest.raises(BundleError, match="no such file"):
        load_posteriors(path)
    short = before.chain.sum(axis=2)[:, :5]
    for other in (replace(before, log_density=short), replace(before, draws=np.zeros((4, 2)))):
        write_posteriors([other], path)
        with pytest.raises(BundleError, match=r"does not match the numbers of 'a'.*fit` again"):
            load_posteriors(path)
    path.write_bytes(b"no HDF5")
    with pytest.raises(BundleError, match="cannot be read as posteriors"):
        load_posteriors(path)


def test_a_set_keeps_its_own_draws_and_one_without_a_posterior_has_none(tmp_path):
    for name, fits in (("with", FITS), ("without", FITS[1:2])):
        commit(tmp_path / name, identification(fits))
        assert output_problems(tmp_path / name) == []
    _, _, posteriors = read_results(tmp_path / "with")
    assert [one.specimen for one in posteriors] == ["a", "c"]
    assert read_results(tmp_path / "without")[2] == ()
    assert not (tmp_path / "without" / POSTERIORS).exists()
    with OutputSet(tmp_path) as run:
        write_results(run, identification(FITS))
        write_posteriors(posteriors_of_fits(FITS[:1]), run.path(POSTERIORS))
        run.commit()
    assert output_problems(tmp_path) == [
        "posteriors.h5 and identification.json name different sampled specimens"
    ]


def test_a_long_chain_and_its_density_are_thinned_alike():
    fit = sampled(specimen_fit("a", trials=1, samples=50))
    chain = np.random.default_rng(3).standard_normal((32, 2000, 3))
    long = replace(fit, posterior=replace(fit.posterior, chain=chain, log_density=chain.sum(axis=2)))
    (kept,) = posteriors_of_fits([long])
    assert kept.chain.shape[1] < 2000
    assert np.array_equal(kept.log_density, kept.chain.sum(axis=2))


def test_curves_and_their_residuals_come_back_exactly_and_in_order(tmp_path):
    path = tmp_path / "curves.h5"
    fits = [specimen_fit("a", trials=3, samples=80, sheet="Blatt 1"), specimen_fit("b", trials=1)]
    first, second, *others = curves_of_fits(fits)
    # files of older runs have no residuals
    old = replace(second, residual=None)
    for expected in ((first, old, *others), (old,), ()):
        write_curves(expected, path)
        for one, other in zip(load_curves(path), expected, strict=True):
            assert (one.specimen, one.path, one.sheet) == (other.specimen, other.path, other.sheet)
            for name in ("time_s", "depth_mm", "force_N", "model_N", "fitted"):
                assert np.array_equal(getattr(one.curve, name), getattr(other.curve, name)), name
            assert (one.residual is None) == (other.residual is None)
            for name in (field.name for field in fields(ResidualSummary) if other.residual is not None):
                assert np.array_equal(getattr(one.residual, name), getattr(other.residual, name)), name
        with h5py.File(path) as file:
            assert ("residual" in file) is (len(expected) > 1)


def test_curves_that_are_cut_or_do_not_match_their_residuals_are_refused(tmp_path):
    path = tmp_path / "curves.h5"
    write_curves(curves_of_fits([specimen_fit(trials=2, samples=80)]), path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-200])
    with pytest.raises(BundleError, match="cannot be read as curves"):
        load_curves(path)
    path.write_bytes(whole)
    with h5py.File(path, "r+") as file:
        del file["residual/lags"]
        file["residual/lags"] = np.zeros(2, dtype=int)
    with pytest.raises(BundleError, match="residuals do not match"):
        load_curves(path)
