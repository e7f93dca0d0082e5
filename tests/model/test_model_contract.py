"""What every registered contact model must keep: the same law fitted, differentiated and stepped."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from passive_tissues import DEPTH_MM, tissue

from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.servo_law import TissueStepper

MODELS = {
    "kelvin-voigt": lambda branches, degree: kelvin_voigt(branches, degree, DEPTH_MM),
}
#: A passive theta for (branches, degree of K).
PASSIVE_THETA = {
    "kelvin-voigt": lambda branches, degree: tissue(branches, degree)[1],
}

CASES = [(key, branches, degree) for key, branches, degree in itertools.product(MODELS, (1, 2, 3), (0, 1, 2))]


def loading_path() -> ContactPath:
    """In and hold, small withdrawals that keep contact, uneven steps, a row of dt = 0, a long gap."""
    rng = np.random.default_rng(11)
    step = 10.0 ** rng.uniform(-3.5, -1.5, 199)
    step[50], step[120] = 0.0, 25.0
    depth = np.concatenate(
        [np.linspace(0.0, 7.5, 120), np.full(40, 7.5), 7.5 - 0.01 * np.arange(1, 21), np.full(20, 7.3)]
    )
    time = np.concatenate([[0.0], np.cumsum(step)])
    return ContactPath(time, depth)


@pytest.fixture(params=CASES, ids=lambda case: "-".join(map(str, case)))
def model_and_theta(request: pytest.FixtureRequest) -> tuple[ChannelModel, np.ndarray]:
    key, branches, degree = request.param
    return MODELS[key](branches, degree), PASSIVE_THETA[key](branches, degree)


def test_model_satisfies_the_protocol(model_and_theta: tuple[ChannelModel, np.ndarray]) -> None:
    model, theta = model_and_theta
    assert isinstance(model, ChannelModel)
    assert model.key in MODELS
    assert len(model.parameters) == len(model.parameter_names) == theta.size
    assert model.is_passive(theta)


def test_stepper_replays_a_path_as_force_computes_it(
    model_and_theta: tuple[ChannelModel, np.ndarray],
) -> None:
    model, theta = model_and_theta
    path = loading_path()
    expected = model.force(theta, path)
    assert expected[1:].min() > 0.0  # in contact throughout, so that the two must be the same
    stepper = TissueStepper(model, theta)
    for _ in range(2):
        actual = [stepper.step(path.depth_mm[0], 0.0)]
        actual += [stepper.step(x, h) for x, h in zip(path.depth_mm[1:], np.diff(path.time_s), strict=True)]
        np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-12)
        stepper.reset()  # the second round starts from a tissue at rest again


def test_jacobian_has_a_column_a_parameter_and_predicts_a_small_change(
    model_and_theta: tuple[ChannelModel, np.ndarray],
) -> None:
    model, theta = model_and_theta
    path = loading_path()
    jacobian = model.jacobian(theta, path)
    assert jacobian.shape == (path.time_s.size, theta.size)
    change = 1e-5 * theta * np.where(np.arange(theta.size) % 2, 1.0, -1.0)
    actual = (model.force(theta + change, path) - model.force(theta - change, path)) / 2.0
    # central difference: relative curvature (1e-5)^2 and rounding 1e-16 / 1e-5, of terms up to 1e-5 * 300 N
    np.testing.assert_allclose(jacobian @ change, actual, rtol=1e-7, atol=1e-11)


def test_two_steppers_do_not_share_their_state(model_and_theta: tuple[ChannelModel, np.ndarray]) -> None:
    model, theta = model_and_theta
    first, second = TissueStepper(model, theta), TissueStepper(model, theta)
    for _ in range(5):
        first.step(5.0, 0.01)
    fresh = TissueStepper(model, theta)
    assert second.step(2.0, 0.01) == fresh.step(2.0, 0.01)
