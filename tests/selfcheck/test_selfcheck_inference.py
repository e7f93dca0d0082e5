"""The posterior that is checked, against one of all samples with nothing linearised or integrated."""

from __future__ import annotations

import numpy as np
import pytest
from coverage_cases import CASES, Case
from scipy.optimize import least_squares

from tissueid.likelihood.sums import LogData
from tissueid.model.base import ContactPath
from tissueid.selfcheck.inference import in_memory, infer
from tissueid.selfcheck.recording import simulated_logs
from tissueid.selfcheck.tissue import TissueCheck
from tissueid.selfcheck.truth import draw_truth

pytestmark = pytest.mark.needs_jit


def recorded(check: TissueCheck, rng: np.random.Generator) -> list[LogData]:
    truth = draw_truth(
        check.model,
        check.priors,
        offset_sd_mm=np.array([log.contact_sd_mm for log in check.logs]),
        pooling=check.pooling,
        correlated=False,
        defects=False,
        rng=rng,
    )
    return simulated_logs(check.model, truth, check.logs, reference_step_s=0.01, white_share=0.0, rng=rng)


def direct_posterior(
    check: TissueCheck, data: list[LogData], start: np.ndarray, *, sigma: float, gain_sd: float
) -> tuple[np.ndarray, np.ndarray]:
    """Mode and Laplace standard deviations of theta, with every gain and offset a parameter of its own."""
    model, priors, logs = check.model, check.priors, len(data)
    names = model.parameter_names
    linear = [k for k, name in enumerate(names) if name in priors.linear]
    times = [k for k, name in enumerate(names) if name.startswith("relaxation")]
    mean, sd = np.array([priors.linear[names[k]] for k in linear]).T

    def parts(p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        theta = p[: len(names)].copy()
        theta[times] = np.exp(theta[times])
        return theta, p[len(names) : len(names) + logs], p[len(names) + logs :]

    def residuals(p: np.ndarray) -> np.ndarray:
        theta, gamma, delta = parts(p)
        out = [
            (
                (np.exp(g) * model.force(theta, ContactPath(one.time_s, one.depth_mm - d)) - one.force_N)
                / sigma
            )[one.include]
            for one, g, d in zip(data, gamma, delta, strict=True)
        ]
        stated = zip(times, priors.relaxation_time_s, strict=True)
        out.append((theta[linear] - mean) / sd)
        out.append(np.array([np.log(theta[k] / prior.median) / prior.sd_ln for k, prior in stated]))
        out += [gamma / gain_sd, delta / check.logs[0].contact_sd_mm]
        return np.concatenate(out)

    first = start.copy()
    first[times] = np.log(first[times])
    found = least_squares(residuals, np.concatenate([first, np.zeros(2 * logs)]), x_scale="jac")
    theta, _, _ = parts(found.x)
    spread = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))[: len(names)]
    spread[times] *= theta[times]
    return theta, spread


@pytest.mark.parametrize("case", [CASES[0], CASES[6]], ids=lambda case: case.name)
def test_posterior_is_that_of_the_model_before_it_is_linearised(case: Case) -> None:
    check, rng = case.check(), np.random.default_rng(case.seed)
    data = recorded(check, rng)
    found = infer(check, data, rng)
    gain_sd = float(np.exp(np.log(found.others["gain_sd"]).mean()))
    sigma = float(found.others["sigma_N"].mean())
    mean, sd = found.theta.mean(axis=0), found.theta.std(axis=0)
    mode, laplace = direct_posterior(check, data, mean, sigma=sigma, gain_sd=gain_sd)
    # a mean of 399 draws is known to 0.05 sd, a skewed one lies 0.2 from its mode
    np.testing.assert_allclose((mode - mean) / sd, 0.0, atol=0.35)
    # scales are integrated on one side and held on the other
    np.testing.assert_allclose(laplace / sd, 1.0, atol=0.2)


def test_a_simulated_log_is_never_read_again() -> None:
    check = CASES[0].check()
    data = recorded(check, np.random.default_rng(1))
    handle = in_memory(check.logs[0], data[0])
    trial, log = handle.fitted()
    assert trial.name == "ramp-60-1"
    assert log.n_samples == int(check.logs[0].include.sum())
    with pytest.raises(RuntimeError, match="lives in memory"):
        handle.load()
