"""Sums for correlated noise: for the chosen degree of K where only the posterior needs them, else for all."""

from __future__ import annotations

import os

import numpy as np
import pytest
from fit_cases import draw, handles_for, small_recipe

from tissueid.fit.specimen import FitOptions, fit_with_state
from tissueid.fit.whitening import for_all_degrees
from tissueid.likelihood.sums import N_STATIC

needs_jit = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="too slow without compilation"
)


def columns_of(degree: int, nodes: int, of: int) -> np.ndarray:
    """Columns of sums for K of one degree among those of sums ``of`` a higher one."""
    return np.append(np.arange(N_STATIC + nodes * (degree + 1)), N_STATIC + nodes * (of + 1))


@needs_jit
def test_sums_of_white_noise_are_for_the_chosen_degree_and_for_all_when_asked():
    handles = handles_for(draw(small_recipe(), 3))
    options = FitOptions(branches=1, noise="white")
    fitted = fit_with_state("a", handles, options=options)
    whitened, chosen = fitted.whitened, fitted.whitened.solution.candidate.degree
    assert chosen < whitened.sums.columns_degree
    assert {one.degree for one in whitened.lags} == {chosen}
    every = for_all_degrees(whitened, fitted.handles)
    keep = columns_of(chosen, whitened.sums.basis.tau_s.size, whitened.sums.columns_degree)
    for few, all_ in zip(whitened.lags, every.lags, strict=True):
        assert all_.degree == whitened.sums.columns_degree
        for kind in ("start", "later", "earlier", "difference"):
            expected = getattr(all_, kind)[..., keep[:, None], keep]
            # chunks of other lengths add in another order: the rounding of a sum of squares
            size = np.sqrt(np.abs(np.einsum("...ii->...i", getattr(all_, kind)[..., keep[:, None], keep])))
            bound = 1e-12 * (size[..., :, None] * size[..., None, :]).max()
            assert getattr(few, kind) == pytest.approx(expected, rel=1e-9, abs=bound)
    assert for_all_degrees(every, fitted.handles) is every


@needs_jit
def test_sums_of_correlated_noise_are_for_every_degree():
    plan = small_recipe(sigma_N=0.0, ar1_sigma_N=0.2, ar1_phi=0.8)
    fitted = fit_with_state("a", handles_for(draw(plan, 3)), options=FitOptions(branches=1))
    assert fitted.whitened.noise.phi == pytest.approx(0.8, abs=0.1)
    assert {one.degree for one in fitted.whitened.lags} == {fitted.whitened.sums.columns_degree}
    assert fitted.whitened.solution.candidate.degree < fitted.whitened.sums.columns_degree
