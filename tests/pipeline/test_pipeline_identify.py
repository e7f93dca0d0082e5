"""The stages in their order: caching, refusals, names, committed numbers, and the Python interface."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tissueid import collection, pipeline, read_trials
from tissueid.documents import plain
from tissueid.documents.identification import TipGeometry
from tissueid.inference.posterior import PosteriorOptions
from tissueid.inference.specimen import FitOptions, FittedSpecimen
from tissueid.inspection import describe_segmented
from tissueid.manifest import Entry, Study
from tissueid.measured.geometry import stated_geometry
from tissueid.model.grammar import KELVIN_VOIGT
from tissueid.pipeline import DEFAULT_REQUIRED, REQUIRABLE, IdentifyOptions, identify
from tissueid.result import Refusal, SpecimenFit
from tissueid.segment import SegmentOptions, segment
from tissueid.store.files import json_bytes
from tissueid.store.schema import first_problem
from tissueid.synth import Branch, Hold, Log, Move, Recipe, as_trials, recipe, simulate
from tissueid.trial import Axes, Source, Trial

QUICK = IdentifyOptions(fit=FitOptions(branches=1, stiffness_degree=0))


@pytest.fixture(scope="module")
def holds() -> list[Trial]:
    """Four ramps and holds of one specimen at 20 Hz."""
    plan = recipe("paper-a-30")
    logs = tuple(replace(log, repeats=1) for log in plan.logs if log.name.startswith("hold"))
    return as_trials(simulate(replace(plan, logs=logs, rate_Hz=20.0), rng=np.random.default_rng(4)))


@pytest.mark.system
def test_an_excluded_trial_is_fitted_again_by_the_law_that_was_chosen_and_with_the_machine_as_it_was(
    holds: list[Trial], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, asked, fitted = holds[0].source.path, [], pipeline.fit_with_state
    study = Study("study.toml", exclusions=(Entry({"because": "x"}, (str(Path(path).resolve()),), 1),))

    def spied(*given: Any, options: FitOptions, machine: bool, **more: Any) -> FittedSpecimen:
        asked.append((len(given[1]), options.model, machine))
        return fitted(*given, options=options, machine=machine, **more)

    monkeypatch.setattr(pipeline, "fit_with_state", spied)
    names = f"{KELVIN_VOIGT} | power * constant * prony"
    strains = [replace(trial, axes=Axes("1", "MPa")) for trial in holds]
    found = identify(strains, study=study, options=replace(QUICK, fit=replace(QUICK.fit, model=names)))
    assert asked == [(3, names, False), (4, found.specimens[0].model.name, False)]
    (row,) = found.exclusions
    assert [one["name"] for one in row["with_it"]] == [one.name for one in found.specimens[0].parameters]


def in_air() -> Trial:
    """A tool that moves and never touches."""
    time = np.arange(200) * 0.05
    force = np.random.default_rng(5).normal(0.0, 0.1, 200)
    return Trial("air", time, 0.5 * time, force, source=Source(path="air.csv"))


def test_reloaded_samples_give_the_bytes_of_kept_samples(holds, monkeypatch) -> None:
    of_path = {trial.source.path: trial for trial in holds}
    loads: list[str] = []

    def reload(source: Source) -> Trial:
        loads.append(source.path)
        return of_path[source.path]

    kept = identify(holds, options=QUICK)
    monkeypatch.setattr(collection, "CACHE_BYTES", 0)
    reloaded = identify(holds, options=QUICK, reload=reload)
    assert json_bytes(reloaded.as_json()) == json_bytes(kept.as_json())
    assert set(loads) == set(of_path)


def test_the_cache_keeps_to_its_bytes(holds: list[Trial], monkeypatch: pytest.MonkeyPatch) -> None:
    def size(trial: Trial) -> int:
        return sum(array.nbytes for array in (trial.time_s, trial.displacement_mm, trial.force_N))

    one = size(holds[-1])
    monkeypatch.setattr(collection, "CACHE_BYTES", 2 * one)
    of_path = {trial.source.path: trial for trial in holds}
    cache = collection.TrialCache(lambda source: of_path[source.path])
    for trial in [*holds, *holds[::-1]]:
        key = (trial.source.path, None)
        if key not in cache._trials:
            cache.keep(key, trial)
        held = sum(size(kept) for kept in cache._trials.values())
        assert held == cache._bytes <= 2 * one
    # what has gone comes back
    for trial in holds:
        assert cache.get((trial.source.path, None), trial.source) is trial


def test_without_reload_nothing_is_thrown_away(holds: list[Trial], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collection, "CACHE_BYTES", 0)
    assert identify(holds, options=QUICK).exit.code == 0


def test_a_generator_is_consumed_once_and_refusals_are_read_after_it(holds: list[Trial]) -> None:
    refused: list[Refusal] = []
    passes = []

    def trials() -> Iterator[Trial]:
        passes.append(1)
        yield from holds
        refused.append(Refusal("late.csv", None, "empty_file", "the file is empty"))

    found = identify(trials(), options=QUICK, refused=refused)
    assert len(passes) == 1
    assert [one.path for one in found.refused] == ["late.csv"]
    assert (found.exit.code, found.exit.reasons) == (7, ("late.csv: the file is empty",))


def test_a_trial_without_contact_is_refused_and_the_others_are_fitted(holds: list[Trial]) -> None:
    found = identify([in_air(), *holds], options=QUICK)
    assert [(one.path, one.code) for one in found.refused] == [("air.csv", "no_contact")]
    assert [len(one.trials) for one in found.specimens] == [len(holds)]
    assert found.exit.code == 7
    assert first_problem(plain(found.as_json()), "identification") is None


def test_nothing_to_fit_is_3() -> None:
    assert identify([], options=QUICK).exit.code == 3
    assert identify([], options=QUICK).exit.reasons == ("no recording was found",)
    assert identify([in_air()], options=QUICK).exit.code == 3


def test_too_few_samples_after_contact_are_refused_by_that_name(holds: list[Trial]) -> None:
    deepest = float(holds[0].displacement_mm.max())
    options = replace(QUICK, segment=SegmentOptions(contact_displacement_mm=deepest))
    found = identify(holds[:1], options=options)
    assert [one.code for one in found.refused] == ["too_few_samples"]


def test_more_parameters_than_residuals_are_no_bug() -> None:
    """Fifteen rows, and fits of up to three branches with K of degree 2."""
    time = np.arange(15) * 0.1
    depth = np.minimum(time, 1.0)
    force = 5.0 * depth**2 + np.random.default_rng(6).normal(0.0, 0.01, 15)
    for branches in (1, 2, 3):
        options = IdentifyOptions(fit=FitOptions(branches=branches, stiffness_degree=2))
        found = identify([Trial("few", time, depth, force)], options=options)
        assert found.exit.code == 4
        assert first_problem(plain(found.as_json()), "identification") is None


def test_a_force_that_rises_at_the_very_end_is_no_bug() -> None:
    time = np.arange(400) * 0.05
    force = np.where(time > 19.7, 50.0 * (time - 19.7), 0.0) + np.random.default_rng(7).normal(0.0, 0.1, 400)
    late = Trial("late", time, time, force)
    found = identify([late], options=QUICK)
    assert found.exit.code in (3, 4, 0)
    # the tool travels 19.7 mm in air: contact is found there, within its last samples, or not at all
    contact = describe_segmented(late, segment(late))["contact"]
    assert contact is None or contact["displacement_mm"] == pytest.approx(19.7, abs=0.5)


def test_specimens_keep_the_order_of_their_first_trial(holds: list[Trial]) -> None:
    named = [replace(trial, specimen=name) for trial, name in zip(holds, "baba", strict=True)]
    found = identify(named, options=QUICK)
    assert [fit.specimen for fit in found.specimens] == ["b", "a"]
    assert [[trial.path for trial in fit.trials] for fit in found.specimens] == [
        [named[0].source.path, named[2].source.path],
        [named[1].source.path, named[3].source.path],
    ]


def test_the_radius_of_the_tip_is_kept_where_all_trials_agree(holds: list[Trial]) -> None:
    def with_radii(*radii: float | None) -> list[Trial]:
        return [
            replace(trial, protocol=replace(trial.protocol, tip_radius_mm=radius))
            for trial, radius in zip(holds, radii, strict=False)
        ]

    assert identify(with_radii(2.0, 2.0), options=QUICK).specimens[0].tip_radius_mm == 2.0
    assert identify(with_radii(2.0, 3.0), options=QUICK).specimens[0].tip_radius_mm is None
    assert identify(with_radii(2.0, None), options=QUICK).specimens[0].tip_radius_mm is None


def test_the_tip_that_a_study_states_is_kept_with_its_shape(holds: list[Trial]) -> None:
    stated = stated_geometry({"shape": "flat", "radius_mm": 3.0}, None, 0.5)
    options = replace(QUICK, fit=replace(QUICK.fit, geometry=stated))
    (fit,) = identify(holds, options=options).specimens
    assert (fit.tip_radius_mm, fit.tip) == (3.0, TipGeometry("flat", None))
    document = plain(fit.as_json())
    assert document["validity"]["tip"] == {"shape": "flat", "half_angle_deg": None}
    assert identify(holds, options=QUICK).specimens[0].tip is None


def test_what_is_required_decides_between_0_and_4(holds: list[Trial]) -> None:
    everything = identify(holds, options=replace(QUICK, required=REQUIRABLE))
    missing = {one.name for one in everything.specimens[0].parameters if not one.identified}
    assert (everything.exit.code == 4) == bool(missing)
    named = [reason.partition("not identified: ")[2] for reason in everything.exit.reasons]
    assert set(", ".join(named).split(", ")) == missing
    assert identify(holds, options=replace(QUICK, required=())).exit.code == 0
    assert DEFAULT_REQUIRED == ("viscosity", "static")


def test_progress_counts_up_to_its_total(holds: list[Trial]) -> None:
    told: list[tuple[str, int, int]] = []
    identify(holds, options=QUICK, progress=lambda message, done, total: told.append((message, done, total)))
    expected = ["reading recording 1"]
    expected += [f"read {one.name}, reading recording {k}" for k, one in enumerate(holds, 2)]
    assert [message for message, _, total in told if total == 0] == expected
    assert told[-1][1:] == (1, 1)


def names(*entries: tuple[str, str | None, str | None]) -> list[str]:
    """Display names of specimens, each given as (path, sheet, label or None)."""
    sources = [
        (label or (path if sheet is None else f"{path}::{sheet}"), Source(path=path, sheet=sheet))
        for path, sheet, label in entries
    ]
    shown = collection.display_names(sources)
    return [shown[specimen] for specimen, _ in sources]


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        ([("lab/day/a.csv", None, None)], ["a"]),
        ([("lab/x/a.csv", None, None), ("lab/y/a.csv", None, None)], ["x/a", "y/a"]),
        ([("lab/x/a.csv", None, None), ("lab/y/b.csv", None, None)], ["a", "b"]),
        ([("p/x/a.csv", None, None), ("q/x/a.csv", None, None)], ["p/x/a", "q/x/a"]),
        ([("a.csv", None, None), ("sub/a.csv", None, None)], ["a", "sub/a"]),
        ([("a.csv", None, None), ("a.txt", None, None)], ["a.csv", "a.txt"]),
        ([("b.xlsx", "S1", None), ("b.xlsx", "S2", None)], ["S1", "S2"]),
        ([("b.xlsx", "S1", None), ("c.xlsx", "S1", None)], ["b/S1", "c/S1"]),
        ([("a.csv", None, "kidney"), ("lab/kidney.csv", None, None)], ["kidney", "lab/kidney"]),
        ([("a.csv", None, "kidney"), ("kidney.csv", None, None)], ["kidney", "kidney.csv"]),
    ],
)
def test_display_names_are_short_and_tell_specimens_apart(entries, expected) -> None:
    assert names(*entries) == expected


def test_ten_thousand_names_are_found_at_once() -> None:
    import time

    begin = time.process_time()
    shown = names(*((f"lab/{i % 100}/{i // 100}.csv", None, None) for i in range(10_000)))
    # comparing each with each would take minutes
    assert time.process_time() - begin < 2.0
    assert len(set(shown)) == 10_000


REFERENCE = Path(__file__).resolve().parents[2] / "reports" / "paper-a" / "identification.json"


def test_committed_sets_give_the_committed_identification(datasets: Path) -> None:
    expected = json.loads(REFERENCE.read_text(encoding="utf-8"))["specimens"]
    folders = (datasets / "paper-a-30-10Hz", datasets / "paper-a-hold-100Hz")
    found = identify([trial for folder in folders for trial in read_trials(folder)]).specimens
    assert [one.specimen for one in found] == [one["specimen"] for one in expected]
    for fit, reference in zip(found, expected, strict=True):
        assert fit.model.as_json() == reference["model"]
        for estimate, then in zip(fit.parameters, reference["parameters"], strict=True):
            assert (estimate.name, estimate.identified) == (then["name"], then["identified"])
            # at 10 Hz the misfit has kinks, and roundings say in which of them a search ends: by the kernels
            # of four processors estimates differ by up to 0.3 standard errors, the misfit by 4e-6
            tolerance = 0.5 * then["detail"]["estimate_stderr"]
            assert estimate.detail["estimate"] == pytest.approx(then["detail"]["estimate"], abs=tolerance)
        assert fit.nrmsd.range == pytest.approx(reference["nrmsd"]["range"], rel=1e-5)


#: K = 0.8 N/mm constant, tau = 2 s.
ETA_N_S_PER_MM = 1.6


def fit(seed, *, repeats=1, speeds=(90.0,), stiffness=(0.8,), sample=False, **options) -> SpecimenFit:
    """Ramps to 5 mm of depth from 1 mm in air, 20 s of hold; stops rounded, displacement with noise."""
    logs = tuple(Log(f"v{speed:g}", (Move(6.0, speed), Hold(20.0)), repeats=repeats) for speed in speeds)
    plan = Recipe(
        "one-speed",
        logs,
        rate_Hz=100.0,
        static=(0.3, 0.05, 0.01),
        branches=(Branch(stiffness, 2.0),),
        sigma_N=0.01,
        sigma_mm=0.0005,
        contact_offset_mm=1.0,
        crosshead_rounding_s=0.06,
    )
    trials = as_trials(simulate(plan, rng=np.random.default_rng(seed)), specimen="a")
    posterior = PosteriorOptions() if sample else None
    chosen = IdentifyOptions(fit=FitOptions(**options), posterior=posterior)
    (found,) = identify(trials, options=chosen).specimens
    return found


def test_a_stiffness_that_varies_with_depth_is_not_made_up_at_one_speed() -> None:
    right = 0
    for seed in range(31, 39):
        found = fit(seed)
        eta = found.parameter("viscosity_N_s_per_mm").value
        # a contact point that is off by its error is in no standard error yet: 1 % instead of 3 sd
        right += found.model.stiffness_degree == 0 and eta == pytest.approx(ETA_N_S_PER_MM, rel=0.01)
    # one log has no contact offset in its fit: in one of eight the contact is so far off that K bends for it
    assert right >= 7


def test_repeats_at_one_speed_make_up_no_varying_stiffness() -> None:
    found = fit(34, repeats=3)
    assert (found.model.branches, found.model.stiffness_degree) == (1, 0)
    assert found.parameter("viscosity_N_s_per_mm").value == pytest.approx(ETA_N_S_PER_MM, rel=0.01)


def test_a_varying_stiffness_asked_for_at_one_speed_is_flagged_with_the_viscosity_at_the_hold() -> None:
    found = fit(31, branches=1, stiffness_degree=2)
    (flag,) = (flag for flag in found.flags if flag.code == "form_dependent")
    # the hold determines K at its own depth, whatever K does above
    assert flag.values["viscosity_N_s_per_mm"] == pytest.approx(ETA_N_S_PER_MM, rel=0.02)
    assert flag.values["depth_mm"] == pytest.approx(5.0, abs=0.05)


@pytest.mark.parametrize("stiffness", [(0.8,), (0.6, 0.05)])
def test_one_push_says_how_far_its_static_force_rests_on_a_constant_stiffness(stiffness) -> None:
    found = fit(34, stiffness=stiffness)
    assert found.model.stiffness_degree == 0
    (flag,) = (flag for flag in found.flags if flag.code == "split_assumed")
    depth, truth = flag.values["depth_mm"], np.polynomial.Polynomial((0.0, 0.3, 0.05, 0.01))
    assert depth == pytest.approx(2.5, abs=0.05)
    assert flag.values["low_N"] < truth(depth) < flag.values["high_N"]
    # what its own interval of a constant K can't hold, where K grows, and its interval in draws has to
    a1 = found.parameter("static_1_N_per_mm")
    assert (abs(a1.value - 0.3) < 5.0 * a1.stderr) == (stiffness == (0.8,))
    drawn = fit(34, stiffness=stiffness, sample=True)
    half = np.polynomial.Polynomial(stiffness)(2.5)
    truths = {"static_1_N_per_mm": 0.3, "static_2_N_per_mm2": 0.05, "static_3_N_per_mm3": 0.01}
    truths |= {"stiffness_0_N_per_mm": stiffness[0], "viscosity_N_s_per_mm": half * 2.0}
    for name, true in truths.items():
        low, high = drawn.parameter(name).uncertainty.ci95
        assert low < true < high, name


def test_two_speeds_are_not_flagged() -> None:
    found = fit(31, speeds=(90.0, 10.0), branches=1, stiffness_degree=1)
    assert "form_dependent" not in {flag.code for flag in found.flags}
    assert "split_assumed" not in {flag.code for flag in fit(31, speeds=(90.0, 10.0)).flags}
