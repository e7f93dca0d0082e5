"""A recipe, a bundle and recordings become protocols with their contact, depth and speeds."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fit_factory import identification, specimen_fit
from msgspec import structs
from posterior_factory import sampled

from tissueid.documents.identification import NoiseFit
from tissueid.errors import InputError, UsageError
from tissueid.manifest import Calibration, Entry, Study
from tissueid.model.frame import linear_frame
from tissueid.selfcheck import protocol as protocols
from tissueid.selfcheck.protocol import Centre, Protocol, of_bundle, of_fit, of_program, of_recipe
from tissueid.selfcheck.tissue import described, tissue_check
from tissueid.store.bundle import Bundle, bundle_from_fit
from tissueid.synth import Branch, Hold, Log, Move, recipe
from tissueid.trial import Source, Trial


def bundle() -> Bundle:
    fit = specimen_fit()
    return bundle_from_fit(fit, provenance=identification([fit]).provenance)


def test_a_recipe_becomes_its_program_and_its_tissue():
    protocol, centre = of_recipe(recipe("paper-a-30-k1"), rate_Hz=100.0)
    assert len(protocol.logs) == 30
    assert protocol.step_s == pytest.approx(0.01, rel=1e-9)
    # 10 mm/min to 8 mm takes 48 s, and the last sample lies one step before its end
    assert protocol.duration_s == pytest.approx(48.0, abs=0.011)
    assert protocol.speeds_mm_s == (10.0 / 60.0, 500.0 / 60.0)
    np.testing.assert_allclose(centre.theta, [20.0, -1.2, 0.35, 63.62, 10.0, 0.021])
    assert (centre.sigma_N, centre.phi, centre.pooling) == (1.0, 0.0, "partial")
    first = protocol.logs[0]
    assert first.contact_sd_mm == protocols.CONTACT_SD_MM
    # a second in air at the speed of the first move, to a contact at 0 s and 0 mm
    air = first.time_s < 0.0
    assert air.sum() == 100
    np.testing.assert_allclose(first.depth_mm[air], first.time_s[air] * 10.0 / 60.0, rtol=1e-12)
    assert (first.time_s[100], first.depth_mm[100]) == (0.0, 0.0)


def test_noise_branches_and_moves_of_a_recipe_are_taken_or_refused():
    plan = recipe("paper-a-hold-100Hz")
    both = of_recipe(replace(plan, sigma_N=0.6, ar1_sigma_N=0.8, ar1_phi=0.9))[1]
    assert (both.sigma_N, both.phi, both.white_share) == pytest.approx((1.0, 0.9, 0.36))
    only = of_recipe(replace(plan, sigma_N=0.0, ar1_sigma_N=0.8, ar1_phi=0.9))[1]
    assert (only.sigma_N, only.phi, only.white_share) == pytest.approx((0.8, 0.9, 0.0))
    protocol, centre = of_recipe(replace(plan, sigma_N=0.6, ar1_sigma_N=0.8, ar1_phi=0.9))
    assert tissue_check(protocol, centre).noise_model == "white+ar1"
    # one log has nothing to pool
    assert centre.pooling == "shared"
    # branches of different degree share the highest
    branches = (Branch((60.0, 2.0), 0.02), Branch((5.0,), 1.0))
    _, centre = of_recipe(replace(plan, branches=branches))
    np.testing.assert_allclose(centre.theta[3:], [60.0, 2.0, 0.02, 5.0, 0.0, 1.0])
    with pytest.raises(InputError, match="stays within its contact's standard deviation"):
        of_program((Log("tiny", (Move(0.02, 60.0),)),), rate_Hz=100.0, contact_sd_mm=0.01, words="tiny")


def test_a_bundle_s_program_stays_within_what_it_was_identified_on():
    one = bundle()
    protocol, centre = of_bundle(one, where="bundle.h5")
    assert protocol.depth_mm <= one.depth_mm * (1.0 + 1e-9)
    assert protocol.depth_mm == pytest.approx(one.depth_mm, rel=0.01)
    low, high = one.speeds_mm_s
    assert protocol.speeds_mm_s == pytest.approx((low, high))
    np.testing.assert_array_equal(centre.theta, one.theta)
    # holds last ten relaxation times, within 5 and 60 s: tau is 1.5 s
    assert "holds of 15 s" in protocol.words
    assert protocols.inputs_there(one) == []
    with pytest.raises((KeyError, ValueError)):
        of_bundle(replace(one, model=replace(one.model, key="hunt-crossley")), where="x")


def test_two_checks_are_told_apart_by_everything_that_decides():
    plan = recipe("paper-a-hold-100Hz")
    logs = (Log("hold", (Move(4.0, 250.0), Hold(1.0))),)
    protocol, centre = of_recipe(replace(plan, logs=logs))
    base = described(tissue_check(protocol, centre))
    assert base == described(tissue_check(protocol, centre))
    others = [
        tissue_check(protocol, replace(centre, sigma_N=2.0)),
        tissue_check(protocol, centre, defects=True),
        replace(tissue_check(protocol, centre), contact_stated=True),
        tissue_check(of_recipe(replace(plan, logs=logs), rate_Hz=50.0)[0], centre),
    ]
    assert all(described(one) != base for one in others)


TIME = np.arange(0.0, 6.0, 0.01)
#: 1 s in air, 4 mm at 4 mm/s, held for 2 s, and back.
DEPTH = np.interp(TIME, [0.0, 1.0, 2.0, 4.0, 5.0, 6.0], [-4.0, 0.0, 4.0, 4.0, -4.0, -4.0])


def trial(path: str, specimen: str = "liver", *, stiffness: float = 30.0) -> Trial:
    noise = 0.05 * np.random.default_rng(4).standard_normal(TIME.size)
    force = stiffness * np.maximum(DEPTH, 0.0) + noise
    return Trial(specimen, TIME, 10.0 + DEPTH, force, source=Source(path, sha256=path))


def of_these(
    trials: Sequence[Trial], study: Study | None = None, **asked: Any
) -> tuple[str, Protocol, Centre]:
    known = {one.source.path: one for one in trials}
    given = protocols.Recordings(iter(trials), lambda source: known[source.path], "lab", study)
    asked = {"specimen": None, "model": None, "progress": lambda *_: None, **asked}
    return protocols.of_recordings(given, **asked)


@pytest.fixture(autouse=True)
def asked(monkeypatch):
    """The arguments of ``identify``, which finds the fit of the factory, with its AR(1) noise."""
    given: dict[str, Any] = {}

    def identify(trials: Sequence[Trial], **options: Any) -> Any:
        given.update(options, trials=trials)
        return identification([sampled(specimen_fit(), total=False)])

    monkeypatch.setattr("tissueid.selfcheck.protocol.identify", identify)
    return given


def test_the_measured_motion_behind_a_known_frame_is_kept_to_where_the_tool_turns_back(asked):
    name, protocol, centre = of_these([trial("a.csv"), trial("b.csv")])
    assert name == "liver"
    assert protocol.words == "the measured x(t) of 2 recordings"
    (first, _) = protocol.logs
    # contact is found to some hundredths of a mm; time is counted from its sample
    assert first.depth_mm[0] == pytest.approx(-4.0, abs=0.05)
    assert first.time_s[0] == pytest.approx(-1.0, abs=0.02)
    assert first.time_s[-1] == pytest.approx(3.0, abs=0.05)
    assert protocol.depth_mm == pytest.approx(4.0, abs=0.05)
    assert protocol.speeds_mm_s == pytest.approx((4.0, 4.0), rel=0.02)
    assert [one.source.path for one in asked["trials"]] == ["a.csv", "b.csv"]
    assert centre.pooling == "partial"
    of_these([trial("a.csv")], model="power * fung")

    assert asked["options"].fit.model == "power * fung"
    study = Study("study.toml", calibration=Calibration(frame=linear_frame(600.0)))
    _, protocol, _ = of_these([trial("a.csv")], study=study)
    # 120 N at 600 N/mm
    assert protocol.depth_mm == pytest.approx(4.0 - 0.2, abs=0.05)


def test_the_tissue_and_the_noise_are_those_that_were_identified():
    fit = sampled(specimen_fit(), total=False)
    centre = of_fit(fit, logs=3)
    assert (centre.sigma_N, centre.phi, centre.white_share) == (0.3, 0.6, 0.0)
    np.testing.assert_array_equal(centre.theta, fit.theta)
    assert centre.model.depth_mm == fit.depth_mm
    # nobody told of the noise: white, as large as the residual
    untold = of_fit(replace(fit, posterior=None), logs=1)
    assert (untold.sigma_N, untold.phi, untold.pooling) == (fit.sigma_N, 0.0, "shared")


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_the_share_of_white_noise_follows_from_its_moving_average(share):
    # AR(1) of variance 1 - share and white noise of variance share: the root of the moving average of
    # r_n - phi r_(n-1) = w_n + v_n - phi v_(n-1), whose autocovariances are (a, -phi share)
    phi = 0.9
    a = (1.0 - share) * (1.0 - phi**2) + share * (1.0 + phi**2)
    b = phi * share
    theta = (a - np.sqrt(a**2 - 4.0 * b**2)) / (2.0 * b)
    noise = NoiseFit(model="white+ar1", sigma_N=1.0, phi=phi, reference_step_s=0.01, moving_average=theta)
    assert protocols.white_share(noise) == pytest.approx(share, rel=1e-9)


def test_of_several_specimens_one_is_named_and_none_is_told_with_its_reason(monkeypatch):
    both = [trial("a.csv"), trial("b.csv", "heart")]
    with pytest.raises(UsageError, match="holds 2 specimens: choose one with --specimen: liver, heart"):
        of_these(both)
    with pytest.raises(UsageError, match="holds no specimen 'lung'; there are liver, heart"):
        of_these(both, specimen="lung")
    with pytest.raises(InputError, match="no recording in which the tool meets a tissue"):
        of_these([trial("a.csv", stiffness=0.0)])
    name, protocol, _ = of_these(both, specimen="heart")
    assert (name, [log.name for log in protocol.logs]) == ("heart", ["b.csv"])
    ended = structs.replace(identification([]).exit, reasons=("why",))
    empty = replace(identification([], refused=True), exit=ended)
    monkeypatch.setattr("tissueid.selfcheck.protocol.identify", lambda *_, **__: empty)
    with pytest.raises(InputError, match="nothing that can be fitted; the first: why"):
        of_these([trial("a.csv")])


def test_what_a_study_says_of_recordings_counts(asked):
    def entry(file: str, **values: Any) -> Entry:
        return Entry(values, (Study.real_path(file),), 1)

    listed = tuple(entry(file, specimen="spleen") for file in ("a.csv", "b.csv"))
    left_out = (entry("b.csv", because="slipped"),)
    study = Study("study.toml", about={"only_listed": True}, trials=listed, exclusions=left_out)
    name, protocol, _ = of_these([trial("a.csv"), trial("b.csv"), trial("c.csv")], study=study)
    assert name == "spleen"
    assert [log.name for log in protocol.logs] == ["a.csv"]
    assert asked["study"] is study


def test_a_bundle_s_own_recordings_are_its_protocol(monkeypatch):
    fit = replace(specimen_fit(trials=1), depth_mm=4.0)
    path = fit.trials[0].path
    provenance = {"inputs": [{"path": path, "sheet": None, "sha256": path, "specimen": fit.specimen}]}
    bundle = bundle_from_fit(fit, provenance=provenance)
    monkeypatch.setattr("tissueid.selfcheck.protocol.inputs_there", lambda one: one.provenance["inputs"])

    def protocol(trials: Sequence[Trial], of: Any = bundle) -> Protocol | None:
        return protocols.of_bundle_inputs(trials, of, study=None, progress=lambda *_: None)

    found = protocol([trial("b.csv"), trial(path)])
    assert [log.name for log in found.logs] == [path]
    # one of them is no longer there, or they are of other depths than the bundle's
    assert protocol([trial("b.csv")]) is None
    shallow = bundle_from_fit(replace(fit, depth_mm=3.0), provenance=provenance)
    assert protocol([trial(path)], shallow) is None
