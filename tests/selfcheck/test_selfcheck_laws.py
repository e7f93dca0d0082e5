"""Truths of any law: drawn within its bounds and its passive set, recorded, asked for by name."""

from __future__ import annotations

import numpy as np
import pytest
from law_cases import LAWS, SPECTRUM, law_bundle

from tissueid.errors import BundleError, InputError
from tissueid.model.base import ContactPath
from tissueid.model.grammar import parsed
from tissueid.priors import Priors, SpreadPrior
from tissueid.selfcheck.protocol import Centre, of_bundle, of_program
from tissueid.selfcheck.tissue import TissueCheck, tissue_check
from tissueid.selfcheck.truth import Widths
from tissueid.synth import Hold, Log, Move


def check_of(name: str, *, stated: Priors | None = None, widths: Widths | None = None) -> TissueCheck:
    logs = (Log("ramp", (Move(4.0, 240.0),)), Log("hold", (Move(4.0, 480.0), Hold(1.0))))
    protocol = of_program(logs, rate_Hz=100.0, contact_sd_mm=0.0, words="two logs")
    model = parsed(name).model(4.0, 0.01, 2.0)
    centre = Centre(model, np.array(LAWS[name]), sigma_N=0.05, phi=0.0, white_share=0.0, pooling="shared")
    return tissue_check(protocol, centre, stated=stated, widths=widths)


@pytest.mark.parametrize("name", LAWS)
def test_truths_are_passive_tissues_around_the_middle_and_are_recorded(name: str) -> None:
    check = check_of(name)
    rng = np.random.default_rng(51)

    truths = [check.truth(rng) for _ in range(60)]

    theta = np.array([one.theta for one in truths])
    model = check.model
    assert all(model.is_passive(one) for one in theta)
    specs = [model.parameters[k] for k in model.shape_places]
    shapes = theta[:, model.shape_places]
    assert (shapes >= [one.lower for one in specs]).all()
    assert (shapes <= [one.upper for one in specs]).all()
    # 15 % for what is no time, 40 % for a time: medians of 60 within three of their errors
    middle = np.median(np.log(shapes), axis=0) - np.log(np.array(LAWS[name])[model.shape_places])
    wide = [0.4 if one.name.startswith("relaxation_time") else 0.15 for one in specs]
    assert (np.abs(middle) < 3.0 * 1.25 * np.array(wide) / np.sqrt(60.0)).all()
    ramp, hold = check.trials(truths[0], rng)
    measured = hold.displacement_mm - hold.displacement_mm[0] + check.logs[1].depth_mm[0]
    force = model.force(theta[0], ContactPath(hold.time_s, np.maximum(measured, 0.0)))
    assert np.sqrt(np.mean((hold.force_N - force) ** 2)) == pytest.approx(truths[0].sigma_N, rel=0.15)
    assert ramp.force_N.max() > 10.0 * truths[0].sigma_N
    assert check.fit.model == name


@pytest.mark.parametrize("name", LAWS)
def test_numbers_that_are_checked_are_those_of_the_law(name: str) -> None:
    check, theta = check_of(name), np.array([LAWS[name], LAWS[name]])

    found = check._numbers(type("Fit", (), {"depth_mm": 4.0})(), theta)

    assert set(check.model.parameter_names) < set(found)
    forces = [value for key, value in found.items() if key.startswith("force_N")]
    slow = np.linspace(0.0, 4.0, 4001)
    dense = check.model.force(theta[0], ContactPath(slow / 4.0, slow))
    # at the largest depth and the slowest speed: 240 mm/min
    assert forces[-1][0] == pytest.approx(dense[-1], rel=1e-3)


def test_a_stated_prior_of_a_shape_stays() -> None:
    stated = Priors(shapes={"static_exponent": SpreadPrior(1.5, 0.01)})

    check = check_of("power * stretched", stated=stated)

    assert check.priors.shapes["static_exponent"].median == 1.5
    assert check.priors.shapes["relaxation_exponent"].median == LAWS["power * stretched"][4]
    drawn = [check.truth(np.random.default_rng(k)).theta[1] for k in range(20)]
    assert np.std(np.log(drawn)) < 0.02


def test_a_prior_beyond_the_bounds_of_a_shape_is_refused_with_them() -> None:
    stated = Priors(shapes={"static_exponent": SpreadPrior(9.0, 0.001)})

    with pytest.raises(InputError, match=r"the prior of static_exponent leaves nothing from 0\.5 to 4"):
        check_of("power * stretched", stated=stated).truth(np.random.default_rng(1))


def test_a_spectrum_is_refused_with_the_way_out() -> None:
    bundle = law_bundle(*SPECTRUM)

    with pytest.raises(BundleError, match="its times follow the recordings; fit another law"):
        of_bundle(bundle, where="bundle.h5")


def test_the_program_of_a_bundle_of_any_law_keeps_its_depth_and_speeds() -> None:
    protocol, centre = of_bundle(
        law_bundle("power * stretched", LAWS["power * stretched"]), where="bundle.h5"
    )

    assert centre.model.name == "power * stretched"
    assert protocol.depth_mm <= 6.0 * (1.0 + 1e-9)
    assert protocol.speeds_mm_s == (1.0, 4.0)
