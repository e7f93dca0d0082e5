"""A cohort is computed once, as ``identify`` does; bytes and time a file, not a square of files."""

import contextlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from cohort_lab import numbers_of, write_cohort, write_specimen
from command_line import QUICK, Ended, read_json, run, write_study

import tissueid
from tissueid.cli.reading import PatternCheck
from tissueid.documents import plain
from tissueid.inference.specimen import FitOptions
from tissueid.manifest import Entry, Study
from tissueid.pipeline import IdentifyOptions
from tissueid.result import Refusal
from tissueid.store.bundle import load_bundle
from tissueid.store.index import read_status
from tissueid.store.results import each_result, read_results
from tissueid.study import batch, pages
from tissueid.study.inventory import files_a_task
from tissueid.study.recordings import FileList, Named, StudyParts


def fit(data: Path, out: Path, **expected: Any) -> Ended:
    """A fit that ends as expected, or well."""
    return run("fit", data, "-o", out, *QUICK, "-q", **({"code": {0, 4}} | expected))


def keys(out: Path) -> dict[str, float]:
    """Name of every specimen's file -> when it was written."""
    return {path.stem: path.stat().st_mtime_ns for path in (out / "specimens").iterdir()}


@pytest.fixture(scope="module")
def cohort(tmp_path_factory):
    """Three specimens, fitted in this process from the folder they are in."""
    folder = tmp_path_factory.mktemp("cohort")
    write_cohort(folder / "lab", 3)
    with contextlib.chdir(folder):
        fit(Path("lab"), Path("out"))
    return folder


@pytest.fixture
def again(cohort, tmp_path, monkeypatch):
    """A copy of them, to change; seen from its folder the recordings are named as they were."""
    shutil.copytree(cohort, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    return Path()


@pytest.fixture
def large(monkeypatch):
    """Three specimens are a large cohort."""
    monkeypatch.setattr(batch, "LARGE", 2)
    return monkeypatch


def test_jobs_find_what_identify_finds_over_all_recordings_at_once(cohort):
    options = IdentifyOptions(fit=FitOptions(branches=1, stiffness_degree=0))
    with contextlib.chdir(cohort):
        expected = tissueid.identify(tissueid.read_trials("lab"), options=options)
    found = read_json(cohort / "out" / "identification.json")
    document = plain(expected.as_json())
    for key in ("specimens", "refused", "unfitted_cycles", "study", "exit"):
        assert found[key] == document[key], key
    assert found["provenance"] | {"reading": None} == document["provenance"] | {"reading": None}


def test_files_of_specimens_are_bundles_and_what_is_there_is_not_computed_again(cohort, again):
    for path in (cohort / "out" / "specimens").iterdir():
        alone = load_bundle(path)
        public = load_bundle(cohort / "out" / f"bundle-{alone.specimen}.h5")
        assert (alone.theta == public.theta).all()
        assert alone.as_json()["parameters"] == public.as_json()["parameters"]
    before, numbers = keys(again / "out"), numbers_of(again / "out")
    fit(again / "lab", again / "out")
    assert keys(again / "out") == before
    assert numbers_of(again / "out") == numbers
    assert read_status(again / "out")["specimens"]["known_before"] == 3


def test_a_new_specimen_leaves_the_others_alone_and_a_changed_one_is_computed_again(again):
    before = keys(again / "out")
    write_specimen(again / "lab", 3)
    fit(again / "lab", again / "out")
    added = keys(again / "out")
    assert len(added) == 4
    assert before.items() <= added.items()
    write_specimen(again / "lab", 1, times=1.1)
    fit(again / "lab", again / "out")
    changed = keys(again / "out")
    # files of nobody are gone with the commit
    assert len(changed) == 4
    assert len(added.items() & changed.items()) == 3
    run("validate", again / "out", code=0)


def test_a_study_that_speaks_of_one_specimen_changes_that_one_only(again):
    title = '[study]\ntitle = "heads"'
    write_study(again / "lab", title)
    fit(again / "lab", again / "out")
    before = keys(again / "out")
    write_study(again / "lab", title, "[[override]]\nfile = 'h1-*.csv'\ncontact_mm = 0.0\nbecause = 'seen'")
    fit(again / "lab", again / "out")
    assert len(before.items() & keys(again / "out").items()) == 2


def test_a_prior_of_no_parameter_is_refused_alike_where_the_files_are_known(again):
    write_study(again / "lab", "[priors.static_exponent]\nmedian = 1.5\nsd_ln = 0.1")
    before = keys(again / "out")
    # once these were failed jobs, with code 3, into a folder that knew its files
    ended = fit(again / "lab", again / "out", code=2)
    assert "[priors.static_exponent] is of no parameter of kelvin-voigt" in ended.stderr
    assert keys(again / "out") == before


def test_a_damaged_file_of_a_specimen_is_found_and_computed_again(again):
    numbers = numbers_of(again / "out")
    first, second, _ = sorted((again / "out" / "specimens").iterdir())
    first.write_bytes(first.read_bytes()[:5_000])
    content = bytearray(second.read_bytes())
    content[len(content) // 2] ^= 0xFF
    second.write_bytes(content)
    run("validate", again / "out", code=6)
    fit(again / "lab", again / "out")
    run("validate", again / "out", code=0)
    assert numbers_of(again / "out") == numbers


def test_a_damaged_index_costs_time_and_no_result(again):
    numbers = numbers_of(again / "out")
    for path in (again / "lab").glob("h[12]-*"):
        path.unlink()
    (again / "out" / "index.sqlite").write_bytes(b"not a database, but long enough to be looked at" * 20)
    fit(again / "lab", again / "out")
    assert numbers_of(again / "out")["head-0"] == numbers["head-0"]


def test_a_large_cohort_has_pages_and_the_same_numbers(again, large):
    numbers = numbers_of(again / "out")
    fit(again / "lab", again / "out")
    out = again / "out"
    public = {path.name for path in out.iterdir() if not path.name.startswith(".")}
    files = {"identification.json", "report.html", "specimens.csv", "specimens", "pages", "index.sqlite"}
    assert public == files
    assert {path.stem for path in (out / "pages").glob("*.html")} == set(keys(out))
    assert numbers_of(out) == numbers
    run("validate", out, code=0)
    page = (out / "report.html").read_text(encoding="utf-8")
    for key in keys(out):
        assert f"pages/{key}.html" in page
    run("report", out, code=0)
    document, curves, posteriors = read_results(out)
    assert len(curves) == sum(len(one.trials) for one in document.specimens) == 6
    assert posteriors == ()
    assert [one.specimen for one, _, _ in each_result(out)] == ["head-0", "head-1", "head-2"]


def test_a_page_made_with_a_fit_is_that_made_of_its_file(again, large):
    def pages_of(out: Path) -> dict[str, bytes]:
        fit(again / "lab", out)
        return {path.name: path.read_bytes() for path in (out / "pages").glob("*.html")}

    later = pages_of(again / "out")
    assert len(later) == 3
    assert pages_of(again / "new") == later


def test_a_page_that_can_not_be_made_costs_no_result(again, large):
    large.setattr(pages, "PAGE", "tissueid.study.pages:no_such_task")
    numbers = numbers_of(again / "out")
    write_specimen(again / "lab", 3)
    fit(again / "lab", again / "out")
    found = numbers_of(again / "out")
    assert found.keys() - numbers.keys() == {"head-3"}
    assert all(found[name] == numbers[name] for name in numbers.keys() - {"document"})
    made = [path.read_text(encoding="utf-8") for path in (again / "out" / "pages").glob("*.html")]
    assert len(made) == 4
    assert all("no page: internal error (AttributeError" in page for page in made)


def test_a_bad_specimen_is_named_and_the_others_are_there(again, monkeypatch):
    real = batch.fit_here

    def fails_once(job: object, **options: object) -> object:
        if getattr(job, "shown", "") == "head-3":
            raise MemoryError
        return real(job, **options)

    write_specimen(again / "lab", 3)
    with monkeypatch.context() as patch:
        patch.setattr(batch, "fit_here", fails_once)
        fit(again / "lab", again / "out", code=7, said=("refused (out_of_memory)", "specimen 'head-3'"))
    document = read_json(again / "out" / "identification.json")
    assert [one["specimen"] for one in document["specimens"]] == ["head-0", "head-1", "head-2"]
    assert document["exit"]["code"] == 7
    status = read_status(again / "out")
    assert status["specimens"]["failed"] == 1
    assert [one["specimen"] for one in status["failures"]] == ["head-3"]
    fit(again / "lab", again / "out")
    run("status", again / "out", code=0)


def test_status_names_what_was_refused(again):
    (again / "lab" / "torn.csv").write_text("Time,Extension,Load\n(s),(mm),(N)\n0,0,0\n1,x,2\n2,2,3\n")
    fit(again / "lab", again / "out", code=7)
    told = ("specimens  3 of 3 done", "torn.csv, line 4, column 2: 'x' stands where a number must be")
    run("status", again / "out", code=7, shown=told)
    status = read_status(again / "out")
    assert status["files"]["refused"] == len(status["refusals"]) == 1
    # nobody misses what the study leaves out anyway
    write_study(again / "lab", "[[exclude]]\nfile = 'torn.csv'\nbecause = 'torn'")
    fit(again / "lab", again / "out")
    run("status", again / "out", code=0)


@pytest.mark.skipif(sys.platform == "win32", reason="no limits of resources here")
def test_a_full_disk_is_named_and_the_same_command_goes_on_later(again):
    import resource

    numbers = numbers_of(again / "out")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    # smaller than the file of a specimen: the system refuses the write as it would on a full disk
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, hard))
    try:
        fit(again / "lab", again / "new", code=6, said="the same command again")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not (again / "new" / "identification.json").exists()
    assert not list((again / "new").rglob(".tmp-*"))
    fit(again / "lab", again / "new")
    assert numbers_of(again / "new") == numbers


FOLDER = Path(os.path.realpath("/")) / "cohort"


def names(count: int) -> list[str]:
    return [str(FOLDER / f"head-{number // 22:05d}" / f"hold-{number % 22}.csv") for number in range(count)]


def study(count: int) -> Study:
    """One table that names all files, one each for every second of them, and an exclusion."""
    files = tuple(names(count))
    trials = [Entry({"file": "*", "speed_mm_s": 4.0}, files, 1)]
    trials += [Entry({"file": one, "specimen": "s"}, (one,), 2) for one in files[::2]]
    return Study("study.toml", trials=tuple(trials), exclusions=(Entry({"because": "x"}, files[:1], 3),))


def test_a_list_of_files_gives_back_what_was_put_in():
    refusal = Refusal("b.csv", None, "no_recording", "nothing there")
    odd = Path(os.fsdecode(b"\xff\xc3\xa9.csv"))
    items: list[Named | Refusal] = [(Path("a.csv"), None), refusal, (Path("meat.xlsx"), "FF1A"), (odd, None)]
    found = FileList(items)
    assert list(found) == items
    assert len(found) == 4


def test_a_task_looks_into_many_short_recordings_or_a_few_long_ones():
    short, long = 4e3, 4e5
    assert files_a_task(220_000, short) == 64
    assert files_a_task(220_000, long) == 8
    # every worker has its share of a small cohort, and a file of unknown size may be long
    assert files_a_task(17 * 22, short) == 8
    assert files_a_task(2_000, short) == 20
    assert files_a_task(220_000, 0.0) == 8


def test_a_list_of_files_takes_little_more_than_their_paths():
    # in an interpreter of its own: memory of other tests and of their tracing is not that of the list
    code = (
        "import gc, tracemalloc\n"
        "from pathlib import Path\n"
        "from tissueid.study.recordings import FileList\n"
        f"files = {names(20_000)!r}\n"
        "FileList((Path(file), None) for file in files)\n"
        "gc.collect()\n"
        "tracemalloc.start()\n"
        "found = FileList((Path(file), None) for file in files)\n"
        "gc.collect()\n"
        # the interpreter's own table of interned strings may grow meanwhile, by a megabyte at once
        "own = tracemalloc.take_snapshot().filter_traces([tracemalloc.Filter(True, '*recordings.py')])\n"
        "held = sum(one.size for one in own.statistics('filename'))\n"
        "print(len(found), held, sum(map(len, files)))\n"
    )
    shown = subprocess.run([sys.executable, "-"], input=code, capture_output=True, text=True, check=True)
    count, held, length = map(int, shown.stdout.split())
    assert count == 20_000
    # 8 bytes of place, an eighth of room to grow in each of two arrays, and half as much again for safety
    assert held / count < 1.5 * (length / count + 8.0)


def test_a_part_of_a_study_decides_as_the_whole_of_it():
    whole = study(60)
    parts = StudyParts(whole)
    for file in names(62):
        assert parts.of_file(file).decision(file, None) == whole.decision(file, None)
    two = names(2)
    part = parts.of_specimen("s", [(file, None) for file in two])
    assert [entry.files for entry in part.trials] == [tuple(two), tuple(two[:1])]


def test_asking_of_every_file_costs_a_time_for_each_and_not_for_each_pair():
    def seconds(count: int) -> float:
        check = PatternCheck(r"head-\d+", study(count))
        begin = time.process_time()
        for file in names(count):
            check.add(file, None)
        return time.process_time() - begin

    seconds(100)
    # eight times the files: 8 times the time, or 64
    assert seconds(4_000) < 24.0 * seconds(500)
