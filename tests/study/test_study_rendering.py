"""What the report says of rendering is what the check before force says; a study graded from a result."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from cohort_outputs import study_of
from fit_factory import THETA, specimen_fit
from posterior_factory import sampled
from typed_call import typed_call

from tissueid.documents import plain
from tissueid.haptics.limits import GuardLimits
from tissueid.ingest.stated import unit_of
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.rendering.precheck import Demands, check_before_force
from tissueid.rendering.tissue_block import Tissue
from tissueid.report.rendering_words import NORMALISED
from tissueid.result import SpecimenFit
from tissueid.store.posteriors import posteriors_of_fits
from tissueid.study.completeness import ITEMS, completeness_of_result
from tissueid.study.pages import rendering_of
from tissueid.trial import Axes

completeness_of_result = typed_call(completeness_of_result)
rendering_of = typed_call(rendering_of)


def rendering(fit: SpecimenFit) -> Any:
    posteriors = posteriors_of_fits([fit])
    return rendering_of(plain(fit.as_json()), posteriors[0] if posteriors else None)


def test_scales_and_damping_are_those_of_the_check_before_force():
    found = rendering(sampled(specimen_fit()))
    model = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=6.0)
    tissue = Tissue(model=model, theta=THETA, speeds_mm_s=(0.5, 4.0), tip_radius_mm=3.0)
    clamp = GuardLimits.simulated().clamp_N
    check = check_before_force(tissue, Demands(clamp, 0.5, 1.5, travel_m=0.064))
    _, simulated = found.devices
    assert simulated.scale.force_scale == pytest.approx(check.scaling.force)
    assert simulated.scale.required_damping_N_s_per_m == pytest.approx(check.required_damping_N_s_per_m)
    # 6 mm at five-fold motion are 30 of the 40 mm that a session on it has
    assert simulated.outside_share == pytest.approx(1 - 30 / 40)
    assert simulated.fastest_hand_mm_s == pytest.approx(20.0)
    assert (found.passive, found.unique) == (True, True)
    assert found.draws == found.draws_passive == 500


def test_what_can_not_be_rendered_is_said_with_its_reason(monkeypatch):
    fit = specimen_fit()
    sinking = tuple(
        replace(one, detail={"estimate": -3.0}) if one.name == "stiffness_0_N_per_mm" else one
        for one in fit.parameters
    )
    assert rendering(replace(fit, parameters=sinking)).passive is False
    assert rendering(replace(fit, axes=Axes("1", "MPa"))) == NORMALISED
    weak = {"a weak device": Demands(2.0, 1e-9, 1.5)}
    monkeypatch.setattr("tissueid.study.pages._devices", lambda: weak)
    (row,) = rendering(specimen_fit()).devices
    assert "can't be felt on this device" in row.why


def test_without_a_study_nothing_is_stated_and_a_result_is_graded_by_what_it_carries():
    nothing = completeness_of_result(None)
    assert (nothing.grade, nothing.share, len(nothing.missing)) == ("F", 0.0, len(ITEMS))
    tables: dict[str, dict[str, Any]] = {item.table: {} for item in ITEMS}
    frame: dict[str, Any] = dict.fromkeys(("path", "sha256", "range_N"))
    frame |= dict.fromkeys(("force_N", "compliance_mm_per_N", "covariance"), ())
    words = {"authors": ["stated"], "shape": "sphere", "freeze_thaw_cycles": 1, "run": 1, "frame": frame}
    for item in ITEMS:
        key = item.keys[0]
        tables[item.table][key] = words.get(key, 1.0 if unit_of(key) or "class" in key else "stated")
    result = study_of(tuple(specimen_fit(name, trials=1) for name in "ab"))
    for name in ("study", "calibration", "tip"):
        result[name] |= tables[name]
    for name in ("specimen", "trial"):
        result[f"{name}s"] = [row | tables[name] for row in result[f"{name}s"]]
    assert completeness_of_result(result).grade == "A"
    result["specimens"][1]["storage"] = None
    (missing,) = completeness_of_result(result).missing
    assert (missing.keys, missing.where) == (("storage",), ("b",))
