"""A posterior made by hand for the fits of fit_factory: normal draws, no sampler involved.

Stiffness and relaxation time are correlated as a ramp leaves them (-0.98), so that viscosity is known better
than either.  Total intervals are wider by a known factor.
"""

from dataclasses import replace

import numpy as np
from fit_factory import TAU_S, THETA, THETA_NAMES
from msgspec import structs

from tissueid.documents.identification import (
    BudgetRow,
    MisfitAlarm,
    MisfitCheck,
    NoiseFit,
    PriorRow,
    SamplerReport,
)
from tissueid.result import SpecimenFit
from tissueid.uncertainty import ParameterUncertainty, Posterior

CORRELATION = -0.98
#: Total standard deviation over the statistical one.
WIDER = 1.8
SOURCES = ("noise", "scatter between logs", "contact points", "force gain", "time skew", "frame")
SHARES = (0.2, 0.06, 0.05, 0.3, 0.09, 0.3)


def draws_of_theta(count: int, *, seed: int) -> np.ndarray:
    """Draws around the truth, shape (count, p)."""
    sd = np.array([0.05, 0.02, 0.003, 0.3, 0.03])
    correlation = np.eye(sd.size)
    correlation[3, 4] = correlation[4, 3] = CORRELATION
    covariance = correlation * np.outer(sd, sd)
    return np.random.default_rng(seed).multivariate_normal(THETA, covariance, count)


def described(draws: np.ndarray, *, total: bool = True) -> ParameterUncertainty:
    low, high = np.quantile(draws, [0.025, 0.975])
    mean = float(draws.mean())
    wide = (mean - WIDER * (mean - low), mean + WIDER * (high - mean)) if total else None
    return ParameterUncertainty(
        mean=mean,
        sd=float(draws.std(ddof=1)),
        ci95=(float(low), float(high)),
        ci95_total=wide,
        ess_bulk=9_600.0,
        ess_tail=8_700.0,
        r_hat=1.001,
    )


def posterior(*, draws: int = 4_000, seed: int = 0, misfit: bool = False, total: bool = True) -> Posterior:
    theta = draws_of_theta(draws, seed=seed)
    columns = dict(zip(THETA_NAMES, theta.T, strict=True))
    columns["viscosity_N_s_per_mm"] = columns["stiffness_0_N_per_mm"] * columns["relaxation_time_s"]
    known = {name: described(values, total=total) for name, values in columns.items()}
    rng = np.random.default_rng(seed + 1)
    chain = np.stack(
        [
            np.log(TAU_S) + 0.02 * rng.standard_normal((8, 400)),
            np.log(0.3) + 0.01 * rng.standard_normal((8, 400)),
            np.arctanh(0.6) + 0.02 * rng.standard_normal((8, 400)),
        ],
        axis=2,
    )
    budget = [
        BudgetRow(name, source, WIDER * one.sd * np.sqrt(share), share)
        for name, one in known.items()
        for source, share in zip(SOURCES, SHARES, strict=True)
    ]
    budget += [BudgetRow(name, "total", WIDER * one.sd, None) for name, one in known.items()]
    budget += [BudgetRow(name, "cluster bootstrap", 1.1 * one.sd, None) for name, one in known.items()]
    place = "2.1 N above the model" if misfit else "where the model puts it"
    checks = (
        MisfitCheck(
            "early hold",
            *((6.2, 1e-4) if misfit else (0.4, 0.6)),
            f"the force just after the peak lies {place}",
            misfit,
        ),
        MisfitCheck("residual structure", 0.9, 0.4, "what is left looks like the noise of the model", False),
    )
    return Posterior(
        sampler=SamplerReport("emcee", True, draws, 0.34, {"steps": 2_000, "walkers": 32, "seed": seed}),
        noise=NoiseFit("ar1", 0.3, 0.6, 0.01),
        parameters=known,
        theta_names=THETA_NAMES,
        draws=theta,
        draws_total=THETA + WIDER * (theta - THETA) if total else None,
        covariance=np.cov(theta.T),
        chain_names=("ln_tau_1", "ln_sigma", "arctanh_phi"),
        chain=chain,
        priors=(
            PriorRow("static_1_N_per_mm", "normal, mean 5, sd 2", True, 4.0, 0.05, 0.975),
            PriorRow("force_gain", "normal, mean 1, sd 0.01", False, 1.0, 0.0098, 0.02),
            PriorRow("skew_s", "normal, mean 0, sd 0.002 s", False, 0.0001, 0.0013, 0.35),
        ),
        budget=tuple(budget),
        misfit=MisfitAlarm(misfit, checks),
    )


def sampled(
    fit: SpecimenFit, *, misfit: bool = False, total: bool = True, converged: bool = True, seed: int = 0
) -> SpecimenFit:
    """The fit with a posterior, and with predictive bands of two noise sd around the model."""
    found = posterior(seed=seed, misfit=misfit, total=total)
    if not converged:
        detail = {**found.sampler.detail, "reason": "R-hat of ln_tau_1 is 1.08 after 20,000 steps"}
        found = replace(found, sampler=structs.replace(found.sampler, converged=False, detail=detail))
    bands = {
        (trial.path, trial.sheet): np.stack(
            [trial.curve.model_N - 0.6, trial.curve.model_N, trial.curve.model_N + 0.6]
        )
        for trial in fit.trials
    }
    parameters = tuple(replace(one, uncertainty=found.parameters.get(one.name)) for one in fit.parameters)
    return replace(fit, parameters=parameters, posterior=replace(found, bands=bands))
