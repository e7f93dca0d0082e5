"""From recordings to a study of their ruptures, and to its output set (``schemas/rupture.schema.json``).

Each is segmented up to its end, each specimen's law fitted as ``tissueid fit`` does without a sampler; what
that law does not know comes from its covariance.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.decided import as_decided
from tissueid.documents import plain
from tissueid.documents.rupture import LeftOut, Rupture
from tissueid.documents.rupture import Test as Failure
from tissueid.errors import InputError, NotIdentifiedError, UsageError, refuse
from tissueid.manifest import Study
from tissueid.model.grammar import KELVIN_VOIGT, ModelNameError, candidates, rebuilt
from tissueid.pipeline import IdentifyOptions, identify, with_model
from tissueid.report.rupture_page import render_rupture
from tissueid.result import Identification, Refusal
from tissueid.rupture.failures import LoadedTest, SpecimenLaw, failures_of, loaded_test
from tissueid.rupture.study import RuptureStudy, rupture_study
from tissueid.rupture_law import DEFAULT_WEIGHT
from tissueid.segment import SegmentOptions, segment
from tissueid.store.bundle import bundle_from_fit, write_bundle
from tissueid.store.files import RUPTURE, bundle_names, json_bytes
from tissueid.store.outputs import OutputSet, refuse_unwritten
from tissueid.store.schema import check
from tissueid.trial import Source, Trial

#: Fewest samples below the contact point that show how a measure grows.
FEWEST_BELOW = 3

_Key = tuple[str, str | None]


@dataclass(frozen=True, slots=True, eq=False)
class RuptureRun:
    """A study of ruptures and the fit behind it."""

    study: RuptureStudy
    identification: Identification
    left_out: tuple[LeftOut, ...]  # fitted recordings that no measure could be taken of


def _watched(
    trials: Iterable[Trial], options: SegmentOptions, study: Study | None, ends: dict[_Key, LoadedTest]
) -> Iterator[Trial]:
    """The same trials; each test up to its end goes to ``ends`` as it passes by."""
    frame = None if study is None else study.calibration.frame
    for raw in trials:
        trial, decided, excluded = as_decided(raw, options, study)
        if excluded is None:
            # the fit refuses what can't be segmented, and says why
            with contextlib.suppress(ArithmeticError, np.linalg.LinAlgError):
                test = loaded_test(trial, segment(trial, options=decided), frame)
                if test is not None:
                    ends[raw.source.path, raw.source.sheet] = test
        yield raw


def run_rupture(
    trials: Iterable[Trial],
    *,
    study: Study | None = None,
    options: IdentifyOptions | None = None,
    reload: Callable[[Source], Trial] | None = None,
    refused: Sequence[Refusal] = (),
    asked: str = "none",
    weight: float = DEFAULT_WEIGHT,
    progress: Callable[[str, int, int], None] | None = None,
) -> RuptureRun:
    """Study the ruptures of a cohort.

    ``trials``: all tests, also those that did not rupture; ``options``: of the fit; a posterior is not
    sampled; ``reload``, ``refused``, ``progress``: as of :func:`tissueid.pipeline.identify`; ``asked``: one
    of :data:`~tissueid.rupture.study.ASKED`; ``weight``: w of the weighted force.  Raises InputError: nothing
    could be fitted; the first refusal says why; NotIdentifiedError: too few tests ruptured, or the recordings
    are normalised.
    """
    fit_options = replace(with_model(options or IdentifyOptions(), study), posterior=None, required=())
    _refuse_yardstick(fit_options.fit.model or KELVIN_VOIGT)
    ends: dict[_Key, LoadedTest] = {}
    identification = identify(
        _watched(trials, fit_options.segment, study, ends),
        study=study,
        options=fit_options,
        reload=reload,
        refused=refused,
        progress=progress,
    )
    if not identification.specimens:
        raise _nothing_fitted(identification)
    failures: list[Failure] = []
    left_out: list[LeftOut] = []
    for fit in identification.specimens:
        if fit.axes.normalised:
            msg = f"{fit.specimen}: the recordings are normalised, and a rupture is measured in mm and N"
            raise NotIdentifiedError(msg)
        model = rebuilt(fit.model, fit.depth_mm)
        law = SpecimenLaw(fit.specimen, model, np.asarray(fit.theta), np.asarray(fit.covariance))
        tests = []
        for trial in fit.trials:
            test = ends.get((trial.path, trial.sheet))
            why = None if test is None else _why_not(test, trial.contact_offset_mm)
            if test is None or why is not None:
                left_out.append(LeftOut(trial.path, trial.sheet, why or "no loading to a depth was found"))
            else:
                tests.append((test, trial.contact_offset_mm))
        failures += failures_of(law, tests, weight=weight)
    return RuptureRun(rupture_study(failures, weight=weight, asked=asked), identification, tuple(left_out))


def _refuse_yardstick(name: str) -> None:
    """Refuse a model without parameters, and a name that is none."""
    try:
        laws = candidates(name)
    except ModelNameError as error:
        raise UsageError(str(error)) from None
    if laws.paper is None and all(one.mark for one in laws.laws):
        refuse(f"{name} has no parameters to quote: name a law of `tissueid models` for a rupture")


def _nothing_fitted(identification: Identification) -> InputError:
    """The first refusal, with how many there are."""
    if not identification.refused:
        return InputError(code="no_recordings", message="no recording was found", path="")
    first, more = identification.refused[0], len(identification.refused) - 1
    message = f"{first.message}; {more} more were refused" if more else first.message
    return InputError(code=first.code, message=message, path=first.path, sheet=first.sheet, line=first.line)


def _why_not(test: LoadedTest, offset_mm: float) -> str | None:
    """Why nothing can be measured at the end of a test."""
    if (test.depth_mm > offset_mm).sum() < FEWEST_BELOW:
        return f"fewer than {FEWEST_BELOW} of its samples lie below the contact point"
    if not (test.force_N > 0.0 and test.work_N_mm > 0.0):
        return "no force or work is left at its end"
    return None


_NAMES = {"force_N": "Force", "depth_mm": "Depth", "work_N_mm": "Work"}


def sentences(study: RuptureStudy) -> list[str]:
    """Sentences of a study, each true by itself."""
    found = [study.confounding.sentence, *_changes(study), _absorbed(study), _sign(study)]
    censored = sum(not one.ruptured for one in study.failures)
    if censored:
        found.append(
            f"{censored} of {len(study.failures)} tests ended without a rupture. They count in the "
            "thresholds as lower bounds; means and standard deviations at a speed are of ruptured tests "
            "alone, and are low where the toughest did not rupture."
        )
    found.append(
        "The criteria are readings: Sadeghnejad et al. state none, and by their equation (7) alone the force "
        "at any depth rises with speed, so that no fall of the force at rupture follows from it."
    )
    return found


def _changes(study: RuptureStudy) -> list[str]:
    if study.confounding.kind in {"confounded", "single speed"}:
        return ["No effect of speed on rupture is claimed."]
    if not study.changes:
        return ["No specimen ruptured at two speeds often enough to say what speed does."]
    found = []
    for one in study.changes:
        percent, low, high = (100.0 * (ratio - 1.0) for ratio in (one.ratio, *one.ci95))
        said = "may fall or rise" if one.direction == "undecided" else one.direction
        found.append(
            f"{_NAMES[one.quantity]} at rupture {said} with speed: {percent:+.1f} % at ten times the speed "
            f"(95 %: {low:+.1f} to {high:+.1f} %), inside specimens."
        )
    return found


def _absorbed(study: RuptureStudy) -> str:
    work = next((one for one in study.changes if one.quantity == "work_N_mm"), None)
    if work is None:
        here = "these tests do not tell."
    elif work.direction == "undecided":
        here = "in these tests the work to rupture does not measurably change."
    else:
        here = f"in these tests the work to rupture {work.direction}."
    return (
        "Mahvash & Dupont (doi 10.1109/ROBOT.2009.5152617) report that less energy is absorbed at higher "
        f"speed; {here} A criterion of constant work can't show such a fall: it makes the energy constant by "
        "construction, and contradicts its source on this point."
    )


def _sign(study: RuptureStudy) -> str:
    found = study.hardening
    if found is None:
        return (
            "The sign test x F_s'/F can't be made: it is of exponentials outside the convolution in their "
            "steady state, and no test ruptured so slowly under such a law."
        )
    low, high = found.ci95
    means = {
        "falls": "above 1: under a constant work the force at rupture falls with speed",
        "rises": "below 1: under a constant work the force at rupture rises with speed",
        "undecided": "its interval holds 1: the sign is undecided",
    }[found.direction]
    return (
        f"Sign test x F_s'/F = {found.mean:.2f} (95 %: {low:.2f} to {high:.2f}, {found.ruptures} ruptures at "
        f"depths of ten v tau or more), {means}."
    )


def as_document(run: RuptureRun, bundles: Mapping[str, str]) -> dict[str, Any]:
    """Write the document, its parts as they are."""
    study, refused = run.study, run.identification.refused

    def members(*names: str) -> dict[str, Any]:
        return {name: getattr(study, name) for name in names}

    return {
        "schema": "tissueid/rupture/1",
        **members("asked", "taken", "weight", "decision"),
        "criteria": study.thresholds,
        **members("confounding", "speeds", "changes", "hardening"),
        "tests": study.failures,
        "laws": [
            {"specimen": name, "bundle": bundles[name], "law": law.as_json()}
            for name, law in study.laws.items()
        ],
        "sentences": sentences(study),
        "left_out": [*run.left_out, *(LeftOut(one.path, one.sheet, one.message) for one in refused)],
        "flags": study.flags,
        "provenance": dict(run.identification.provenance),
    }


PAGE = "rupture.html"


def write_rupture(out: Path, run: Callable[[], RuptureRun]) -> dict[str, Any]:
    """Write the set that ``run`` gives, all at once or not at all; it is called in a folder that is ours."""
    refuse_unwritten(out, (RUPTURE, PAGE, "bundle*.h5"))
    with OutputSet(out) as files:
        found = run()
        specimens = found.identification.specimens
        by_specimen = bundle_names(fit.specimen for fit in specimens)
        document: dict[str, Any] = plain(as_document(found, by_specimen))
        read = check(document, Rupture, where=RUPTURE)
        files.write(RUPTURE, json_bytes(document))
        for fit in specimens:
            bundle = bundle_from_fit(fit, provenance=found.identification.provenance)
            law = found.study.laws.get(fit.specimen)
            write_bundle(replace(bundle, rupture=law), files.path(by_specimen[fit.specimen]))
        created = datetime.now(UTC).isoformat(timespec="seconds")
        files.write(PAGE, render_rupture(read, created=created).encode("utf-8"))
        files.commit()
    return document
