"""The document of ``schemas/rupture.schema.json``, its sentences, and the output set it stands in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.documents import typed
from tissueid.documents.rupture import Rupture
from tissueid.errors import UsageError
from tissueid.report.rupture_page import render_rupture
from tissueid.rupture.evidence import Threshold
from tissueid.rupture.failures import Failure
from tissueid.rupture.run import RuptureRun
from tissueid.rupture.speeds import AtSpeed, Change
from tissueid.rupture.study import RuptureStudy
from tissueid.rupture_law import THRESHOLD_UNITS
from tissueid.store.bundle import bundle_from_fit, write_bundle
from tissueid.store.files import IDENTIFICATION, bundle_names, json_bytes, plain_json
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
            "thresholds "
            "as lower bounds; means and standard deviations at a speed are of ruptured tests alone, and "
            "are low "
            "where the toughest did not rupture."
        )
    found.append(
        "The criteria are readings: Sadeghnejad et al. state none, and by their equation (7) alone the "
        "force at "
        "any depth rises with speed, so that no fall of the force at rupture follows from it."
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
    said = {
        "falls": "falls with speed",
        "rises": "rises with speed",
        "undecided": "may fall or rise with speed",
    }[one.direction]
    return (
        f"{_NAMES[one.quantity]} at rupture {said}: {percent:+.1f} % at ten times the speed (95 %: "
        f"{low:+.1f} "
        f"to {high:+.1f} %), inside specimens."
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
        "speed; "
        f"{here} A criterion of constant work can't show such a fall: it makes the energy constant by "
        "construction, and contradicts its source on this point."
    )


def _sign(study: RuptureStudy) -> str:
    found = study.hardening
    if found is None:
        return (
            "The sign test x F_s'/F can't be made: every test ruptured so fast that the relaxing branch was "
            "not in its steady state."
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
    """Write the document.

    ``bundles``: file name of each specimen's bundle.
    """
    study, hardening = run.study, run.study.hardening
    return {
        "schema": "tissueid/rupture/1",
        "asked": study.asked,
        "taken": study.taken,
        "weight": study.weight,
        "decision": asdict(study.decision) | {"probability": dict(study.decision.probability)},
        "criteria": [_threshold(one) for one in study.thresholds],
        "confounding": study.confounding.as_json(),
        "speeds": [_at_speed(one, study.failures) for one in study.speeds],
        "changes": [asdict(one) | {"direction": one.direction} for one in study.changes],
        "hardening": None if hardening is None else asdict(hardening) | {"direction": hardening.direction},
        "tests": [_test(one) for one in study.failures],
        "laws": [
            {"specimen": name, "bundle": bundles[name], "law": law.as_json()}
            for name, law in study.laws.items()
        ],
        "sentences": sentences(study),
        "left_out": [
            *(
                {"path": path, "sheet": sheet or None, "reason": reason}
                for path, sheet, reason in run.left_out
            ),
            *(
                {"path": one.path, "sheet": one.sheet, "reason": one.message}
                for one in run.identification.refused
            ),
        ],
        "flags": [flag.as_json() for flag in study.flags],
        "provenance": dict(run.identification.provenance),
    }


def _threshold(one: Threshold) -> dict[str, Any]:
    return {
        "criterion": one.criterion,
        "unit": THRESHOLD_UNITS[one.criterion],
        "median": one.median,
        "ci95": list(one.ci95),
        "sd_ln": one.sd_ln,
        "specimen_sd_ln": one.specimen_sd_ln,
        "ln_evidence": one.ln_evidence,
        "growth": one.growth,
        "trend": one.trend,
        "trend_p": one.trend_p,
        "specimens": dict(one.specimens),
    }


def _at_speed(one: AtSpeed, failures: tuple[Failure, ...]) -> dict[str, Any]:
    """One speed; how much of the force relaxes there, and the tangent over the secant, are means too."""
    near = [
        each
        for each in failures
        if each.ruptured and abs(np.log(each.test.speed_mm_s / one.speed_mm_s)) < SAME_SPEED
    ]
    return asdict(one) | {
        "mean": dict(one.mean),
        "sd": dict(one.sd),
        "hardening": float(np.mean([each.hardening for each in near])) if near else None,
        "dynamic_share": float(np.mean([each.dynamic_share for each in near])) if near else None,
    }


#: Speeds that differ by less than this in ln are one.
SAME_SPEED = 0.05


def _test(one: Failure) -> dict[str, Any]:
    test = one.test
    return {
        "path": test.path,
        "sheet": test.sheet,
        "specimen": one.specimen,
        "ruptured": one.ruptured,
        "speed_mm_s": test.speed_mm_s,
        "force_N": test.force_N,
        "force_sd_N": one.force_sd_N,
        "depth_mm": one.depth_mm,
        "depth_sd_mm": one.depth_sd_mm,
        "work_N_mm": test.work_N_mm,
        "work_sd_N_mm": one.work_sd_N_mm,
        "dynamic_share": one.dynamic_share,
        "hardening": one.hardening,
        "hardening_sd": one.hardening_sd,
        "settled": one.settled,
        "residual": test.residual,
        "measures": {name: asdict(measure) for name, measure in one.measures.items()},
    }


RUPTURE = "rupture.json"
PAGE = "rupture.html"


def write_rupture(out: Path, run: Callable[[], RuptureRun]) -> dict[str, Any]:
    """Write the set, all at once or not at all.

    ``run``: gives the study; called once the folder is ours.  Returns rupture.json.  Raises UsageError: the
    folder holds the outputs of a fit, or files that are not ours.
    """
    refuse_foreign(out)
    with OutputSet(out) as files:
        found = run()
        specimens = found.identification.specimens
        by_specimen = bundle_names(fit.specimen for fit in specimens)
        document: dict[str, Any] = plain_json(as_document(found, by_specimen))
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
