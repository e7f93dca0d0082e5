"""Files of a fit's output folder, by name, and how it is read back and checked.

``identification.json`` (the numbers), ``bundle-<specimen>.h5`` (the models), ``bundle.h5`` where there is one
specimen, ``curves.h5`` (what a report draws), ``posteriors.h5`` (draws, where a posterior was sampled),
``specimens.csv`` (which files of ``specimens/`` belong to the run: each holds all of these for one).  A large
cohort has the document, the list and the files of specimens only.  A report is written into the same set by
whoever made it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from tissueid.documents import typed
from tissueid.documents.identification import Identification as IdentificationDocument
from tissueid.documents.identification import Specimen
from tissueid.documents.rupture import Rupture
from tissueid.documents.twin import Twin
from tissueid.errors import BundleError
from tissueid.store.bundle import load_bundle
from tissueid.store.curves import TrialCurve, load_curves
from tissueid.store.files import (
    CURVES,
    IDENTIFICATION,
    ONLY_BUNDLE,
    POSTERIORS,
    RUPTURE,
    bundle_names,
    sha256_of,
)
from tissueid.store.merged import LISTED, SPECIMENS, load_specimen, read_listed
from tissueid.store.outputs import CommittedRun, complete_refresh, current_run
from tissueid.store.posteriors import StoredPosterior, load_posteriors
from tissueid.store.schema import check, first_problem

_T = TypeVar("_T")

#: Place of a twin in an output folder.
TWIN = Path("twin") / "twin.json"
_LONGEST_LIST = 8
_WAY_OUT, _RUPTURE_AGAIN = (f"run `tissueid {command}` again" for command in ("fit", "rupture"))

#: Specimen of a run, its curves and its draws.
Result = tuple[Specimen, tuple[TrialCurve, ...], StoredPosterior | None]


def read_identification(out: Path | str) -> IdentificationDocument:
    """Read the identification document of an output folder alone."""
    return load_identification(committed_fit(Path(out)).folder / IDENTIFICATION)


def read_plain(out: Path | str) -> dict[str, Any]:
    """Read the same as plain dicts, lists and values, to be printed or written again."""
    return _read(committed_fit(Path(out)).folder / IDENTIFICATION, IdentificationDocument)[0]


def read_twin(out: Path) -> Twin | None:
    """Twin of an output folder, where ``render --twin`` left one; BundleError where it is none."""
    path = out / TWIN
    if not path.is_file():
        return None
    return _read(path, Twin, "run `tissueid render --twin` again, or delete it")[1]


def load_identification(path: Path) -> IdentificationDocument:
    """Read an identification document by its file; BundleError where it can't be read, or is none."""
    return _read(path, IdentificationDocument)[1]


def read_results(
    out: Path | str,
) -> tuple[IdentificationDocument, tuple[TrialCurve, ...], tuple[StoredPosterior, ...]]:
    """Read the identification document, the curves and the draws of an output folder, all at once.

    Raises BundleError: if there is no committed set or it is damaged.
    """
    run = committed_fit(Path(out))
    document = load_identification(run.folder / IDENTIFICATION)
    if CURVES in run.files:
        return document, load_curves(run.folder / CURVES), _posteriors(run)
    curves: list[TrialCurve] = []
    posteriors = []
    for _, own, posterior in each_result(out):
        curves += own
        posteriors += [] if posterior is None else [posterior]
    return document, tuple(curves), tuple(posteriors)


def each_result(out: Path | str) -> Iterator[Result]:
    """Read specimen, curves and draws of an output folder one at a time, however large the cohort is.

    Raises BundleError: if there is no committed set or it is damaged.
    """
    run = committed_fit(Path(out))
    if LISTED in run.files:
        for one in read_listed(run.folder / LISTED):
            if one.fitted:
                record, own, posterior = load_specimen(Path(out) / SPECIMENS / one.file)
                yield typed(record.fitted, Specimen), own, posterior
        return
    curves = load_curves(run.folder / CURVES)
    posteriors = {one.specimen: one for one in _posteriors(run)}
    for entry in load_identification(run.folder / IDENTIFICATION).specimens:
        name = entry.specimen
        yield entry, tuple(one for one in curves if one.specimen == name), posteriors.get(name)


def validate_outputs(out: Path | str) -> None:
    """Refuse an output folder that is not wholly one run's, by a BundleError that names every problem."""
    # a folder without a run says so itself, with the way out
    way_out = _RUPTURE_AGAIN if RUPTURE in _committed(Path(out)).files else _WAY_OUT
    problems = output_problems(out)
    if problems:
        shown = problems[:_LONGEST_LIST]
        if len(problems) > len(shown):
            shown.append(f"and {len(problems) - len(shown)} more")
        msg = f"{out}: the output set is not whole: {'; '.join(shown)}"
        if not any(way_out in problem.lower() for problem in shown):
            msg += f". {way_out.capitalize()}"
        raise BundleError(msg)


def output_problems(out: Path | str) -> list[str]:
    """Everything that is wrong with an output folder, in words; empty for a whole set."""
    out = Path(out)
    try:
        run = _committed(out)
    except BundleError as error:
        return [error.message]
    problems = list(_hash_problems(out, run))
    if problems:
        return problems
    if RUPTURE in run.files:
        return list(_rupture_problems(out, run))
    if CURVES not in run.files:
        return _large_problems(out, run)
    try:
        plain, document = _read(out / IDENTIFICATION, IdentificationDocument)
        curves = load_curves(out / CURVES)
        posteriors = _posteriors(run)
    except BundleError as error:
        return [error.message]
    # of its whole schema, which says more than the types that it was read by
    broken = first_problem(plain, "identification")
    problems = [] if broken is None else [f"{IDENTIFICATION} breaks its schema at {broken}"]
    problems += [*_specimen_problems(out, run), *_bundle_problems(out, run, plain)]
    fitted = [(s.specimen, t.path, t.sheet) for s in document.specimens for t in s.trials]
    if fitted != [(entry.specimen, entry.path, entry.sheet) for entry in curves]:
        problems.append(f"{CURVES} and {IDENTIFICATION} name different trials")
    sampled = [s.specimen for s in document.specimens if s.sampler is not None]
    if sampled != [entry.specimen for entry in posteriors]:
        problems.append(f"{POSTERIORS} and {IDENTIFICATION} name different sampled specimens")
    return problems


def _posteriors(run: CommittedRun) -> tuple[StoredPosterior, ...]:
    return load_posteriors(run.folder / POSTERIORS) if POSTERIORS in run.files else ()


def committed_fit(out: Path) -> CommittedRun:
    """Find the finished fit of a folder; BundleError where it has none."""
    run = _committed(out)
    if RUPTURE in run.files:
        raise BundleError(f"{out}: holds tests to rupture and no fit; fit them into a folder of their own")
    return run


def _committed(out: Path) -> CommittedRun:
    complete_refresh(out)
    run = current_run(out)
    if run is None:
        raise BundleError(f"{out}: holds no finished run; `tissueid fit ... -o {out}` makes one")
    return run


def _read(path: Path, kind: type[_T], way_out: str = _WAY_OUT) -> tuple[dict[str, Any], _T]:
    try:
        document: dict[str, Any] = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise BundleError(f"{path}: cannot be read as JSON ({error}); {way_out}") from error
    return document, check(document, kind, where=str(path), way_out=way_out)


def _hash_problems(out: Path, run: CommittedRun) -> Iterable[str]:
    for name, entry in run.files.items():
        path = out / name
        if not path.is_file():
            yield f"{name} is missing (a copy is in {run.folder})"
        elif path.stat().st_size != entry["bytes"] or sha256_of(path) != entry["sha256"]:
            yield f"{name} is not the one this run wrote (a copy is in {run.folder})"
    for name in () if RUPTURE in run.files else (IDENTIFICATION, CURVES):
        if name not in run.files and not (name == CURVES and LISTED in run.files):
            yield f"{name} was never part of the set"


def _rupture_problems(out: Path, run: CommittedRun) -> Iterator[str]:
    """Faults of the document and the bundles of a set of tests to rupture."""
    try:
        broken = first_problem(_read(out / RUPTURE, Rupture, _RUPTURE_AGAIN)[0], "rupture")
        if broken is not None:
            yield f"{RUPTURE} breaks its schema at {broken}"
        for name in run.files:
            if name.endswith(".h5"):
                load_bundle(out / name)
    except BundleError as error:
        yield error.message


def _specimen_problems(out: Path, run: CommittedRun) -> Iterator[str]:
    """Faults of the files of specimens that the run lists."""
    if LISTED not in run.files:
        return
    for one in read_listed(run.folder / LISTED):
        path = out / SPECIMENS / one.file
        if not path.is_file():
            yield f"{SPECIMENS}/{one.file} ({one.specimen}) is missing"
        elif path.stat().st_size != one.bytes or sha256_of(path) != one.sha256:
            yield f"{SPECIMENS}/{one.file} ({one.specimen}) is not the one this run wrote"


def _large_problems(out: Path, run: CommittedRun) -> list[str]:
    """A set without merged files: every listed specimen stands in the document, in its order."""
    problems = list(_specimen_problems(out, run))
    if problems:
        return problems
    try:
        listed = [one for one in read_listed(run.folder / LISTED) if one.fitted]
        document = json.loads((out / IDENTIFICATION).read_bytes())
        if [one.specimen for one in listed] != [entry["specimen"] for entry in document["specimens"]]:
            return [f"{LISTED} and {IDENTIFICATION} name different specimens"]
        problems += [
            f"{SPECIMENS}/{one.file} is not of specimen {one.specimen!r}"
            for one in listed
            if load_bundle(out / SPECIMENS / one.file).specimen != one.specimen
        ]
    except (BundleError, OSError, ValueError, KeyError, TypeError) as error:
        problems.append(f"{IDENTIFICATION} can't be checked ({error}); {_WAY_OUT}")
    return problems


def _bundle_problems(out: Path, run: CommittedRun, document: Mapping[str, Any]) -> Iterable[str]:
    specimens = {entry["specimen"]: entry for entry in document["specimens"]}
    owner = {name: specimen for specimen, name in bundle_names(specimens).items()}
    if len(specimens) == 1:
        owner[ONLY_BUNDLE] = next(iter(specimens))
    for name in sorted(set(owner) - set(run.files)):
        yield f"{name} is missing from the set"
    for path in sorted(out.glob("bundle*.h5")):
        if path.name not in owner:
            yield f"{path.name} belongs to no specimen of {IDENTIFICATION}"
    for name in sorted(set(owner) & set(run.files)):
        try:
            bundle = load_bundle(out / name)
        except BundleError as error:
            yield error.message
            continue
        entry = specimens[owner[name]]
        if bundle.specimen != entry["specimen"]:
            yield f"{name} is of specimen {bundle.specimen!r}, not {entry['specimen']!r}"
        for key in ("model", "parameters", "validity", "sigma_N"):
            if bundle.as_json()[key] != entry[key]:
                yield f"{name} and {IDENTIFICATION} differ in {key}"
