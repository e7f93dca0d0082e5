"""Stand-ins of ``tissueid.identify`` that take no time: of posteriors that are known, no engine involved.

Each takes the recordings of a simulated specimen and the study with its priors, and gives an identification.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from closed_forms import linear_basis
from fit_factory import identification, specimen_fit
from posterior_factory import posterior

from tissueid.manifest import Study
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.pipeline import IdentifyOptions
from tissueid.priors import Priors
from tissueid.result import Estimate, Identification, ModelChoice
from tissueid.selfcheck.truth import drawn_tissue, numbers_of
from tissueid.synth.simulate import Path, contact_path
from tissueid.trial import Trial
from tissueid.uncertainty import ParameterUncertainty

DRAWS = 399

Draws = Callable[[ChannelModel, Priors, Sequence[Trial], np.random.Generator], np.ndarray]


def stand_in(draws_of: Draws) -> Callable[..., Identification]:
    """An ``identify`` whose draws of theta are those of a function."""

    def identify(trials, *, study: Study, options: IdentifyOptions, **_) -> Identification:
        depth = max(float(trial.displacement_mm.max()) for trial in trials)
        model = kelvin_voigt(options.fit.branches, options.fit.stiffness_degree, depth)
        rng = np.random.default_rng(options.seed)
        theta = draws_of(model, study.priors, trials, rng)
        return of_draws(model, theta)

    return identify


def of_draws(model: ChannelModel, theta: np.ndarray, **changed: Any) -> Identification:
    """An identification with these draws, and their central intervals quoted."""
    parameters = tuple(
        Estimate(name, name, "", float(values.mean()), None, identified=True, uncertainty=known(values))
        for name, values in numbers_of(model, theta, ()).items()
    )
    own = posterior(draws=10)
    fit = replace(
        specimen_fit("simulated", trials=1, samples=20),
        model=ModelChoice("kelvin-voigt", model.branches, 3, model.stiffness_degree, "partial"),
        parameters=parameters,
        theta_names=model.parameter_names,
        theta=theta.mean(axis=0),
        depth_mm=model.depth_mm,
        posterior=replace(
            own, **{"theta_names": model.parameter_names, "draws": theta, "draws_total": theta, **changed}
        ),
    )
    return identification([fit])


def known(values: np.ndarray) -> ParameterUncertainty:
    """Of draws, the total as the statistical."""
    low, high = (float(end) for end in np.quantile(values, [0.025, 0.975]))
    return ParameterUncertainty(
        float(values.mean()), float(values.std()), (low, high), (low, high), 399.0, 399.0, 1.0
    )


def prior_draws(model, priors, trials, rng) -> np.ndarray:
    """The prior itself, whatever was recorded: calibrated by construction."""
    return np.array([drawn_tissue(model, priors, rng) for _ in range(DRAWS)])


def sure_draws(model, priors, trials, rng) -> np.ndarray:
    """Sure of the middle of the priors, whatever was recorded."""
    times = {"relaxation_time_s": priors.relaxation_time_s[0].median}
    middle = [times.get(name) or priors.linear[name][0] for name in model.parameter_names]
    return np.array(middle) * (1.0 + 1e-3 * rng.standard_normal((DRAWS, len(middle))))


def conjugate_draws(model, priors, trials, rng) -> np.ndarray:
    """The exact posterior of F_s and K, normal where times, noise, gains and contact points are known."""
    taus = [time.median for time in priors.relaxation_time_s]
    sigma = priors.sigma_N.median
    at = [k for k, name in enumerate(model.parameter_names) if name in priors.linear]
    mean, sd = np.array([priors.linear[model.parameter_names[k]] for k in at]).T
    precision = np.diag(sd**-2.0)
    weighted = mean * sd**-2.0
    for trial in trials:
        path = contact_path(Path(trial.time_s, trial.displacement_mm), 0.0)
        basis = linear_basis(model, np.log(taus), ContactPath(path.time_s, path.value_mm))
        rows = basis[np.searchsorted(path.time_s, trial.time_s)]
        precision += rows.T @ rows / sigma**2
        weighted = weighted + rows.T @ trial.force_N / sigma**2
    root = np.linalg.cholesky(precision)
    centre = np.linalg.solve(precision, weighted)
    theta = np.empty((DRAWS, len(model.parameter_names)))
    theta[:, at] = centre + np.linalg.solve(root.T, rng.standard_normal((len(at), DRAWS))).T
    for k, time in zip(sorted({*range(theta.shape[1])} - {*at}), priors.relaxation_time_s, strict=True):
        theta[:, k] = time.median * np.exp(time.sd_ln * rng.standard_normal(DRAWS))
    return theta


of_prior = stand_in(prior_draws)
too_sure = stand_in(sure_draws)
conjugate = stand_in(conjugate_draws)
