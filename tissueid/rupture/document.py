"""The document of ``schemas/rupture.schema.json``, its sentences, and the output set it stands in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tissueid.documents import plain, typed
from tissueid.documents.rupture import Change, LeftOut, Rupture
from tissueid.errors import UsageError
from tissueid.report.rupture_page import render_rupture
from tissueid.rupture.failures import Failure
from tissueid.rupture.run import RuptureRun
from tissueid.rupture.study import RuptureStudy
from tissueid.store.bundle import bundle_from_fit, write_bundle
from tissueid.store.files import IDENTIFICATION, bundle_names, json_bytes
from tissueid.store.outputs import OutputSet
from tissueid.store.schema import check

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
    return [_change(one) for one in study.changes]


def _change(one: Change) -> str:
    percent = 100.0 * (one.ratio - 1.0)
    low, high = (100.0 * (end - 1.0) for end in one.ci95)
    said = "may fall or rise" if one.direction == "undecided" else one.direction
    return (
        f"{_NAMES[one.quantity]} at rupture {said} with speed: {percent:+.1f} % at ten times the speed "
        f"(95 %: {low:+.1f} to {high:+.1f} %), inside specimens."
    )


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
    return {
        "schema": "tissueid/rupture/1",
        "asked": study.asked,
        "taken": study.taken,
        "weight": study.weight,
        "decision": study.decision,
        "criteria": study.thresholds,
        "confounding": study.confounding,
        "speeds": study.speeds,
        "changes": study.changes,
        "hardening": study.hardening,
        "tests": [_test(one) for one in study.failures],
        "laws": [
            {"specimen": name, "bundle": bundles[name], "law": law.as_json()}
            for name, law in study.laws.items()
        ],
        "sentences": sentences(study),
        "left_out": [*run.left_out, *(LeftOut(one.path, one.sheet, one.message) for one in refused)],
        "flags": study.flags,
        "provenance": dict(run.identification.provenance),
    }


#: What is told of a test as it was loaded, and of its measures.
_LOADED = ("path", "sheet", "speed_mm_s", "force_N", "work_N_mm", "residual")
_MEASURED = (
    "specimen", "ruptured", "force_sd_N", "depth_mm", "depth_sd_mm", "work_sd_N_mm", "dynamic_share",
    "hardening", "hardening_sd", "settled",
)  # fmt: skip


def _test(one: Failure) -> dict[str, Any]:
    loaded = {name: getattr(one.test, name) for name in _LOADED}
    return loaded | {name: getattr(one, name) for name in _MEASURED} | {"measures": one.measures}


RUPTURE = "rupture.json"
PAGE = "rupture.html"


def write_rupture(out: Path, run: Callable[[], RuptureRun]) -> dict[str, Any]:
    """Write the set that ``run`` gives, all at once or not at all; it is called in a folder that is ours."""
    refuse_foreign(out)
    with OutputSet(out) as files:
        found = run()
        specimens = found.identification.specimens
        by_specimen = bundle_names(fit.specimen for fit in specimens)
        document: dict[str, Any] = plain(as_document(found, by_specimen))
        check(document, "rupture", where=RUPTURE)
        files.write(RUPTURE, json_bytes(document))
        for fit in specimens:
            bundle = bundle_from_fit(fit, provenance=found.identification.provenance)
            law = found.study.laws.get(fit.specimen)
            write_bundle(replace(bundle, rupture=law), files.path(by_specimen[fit.specimen]))
        created = datetime.now(UTC).isoformat(timespec="seconds")
        files.write(PAGE, render_rupture(typed(document, Rupture), created=created).encode("utf-8"))
        files.commit()
    return document


def refuse_foreign(out: Path) -> None:
    """A fit's outputs, and files that nobody of ours wrote, stay where they are."""
    if (out / IDENTIFICATION).exists():
        msg = f"{out} holds the outputs of `tissueid fit`, which this would replace: choose another folder"
        raise UsageError(msg)
    if (out / ".current").exists() or not out.is_dir():
        return
    foreign = sorted(path.name for name in (RUPTURE, PAGE, "bundle*.h5") for path in out.glob(name))
    if foreign:
        msg = (
            f"{out} holds {', '.join(foreign)} that tissueid did not write there: choose another folder "
            "with -o, or move them away"
        )
        raise UsageError(msg)
