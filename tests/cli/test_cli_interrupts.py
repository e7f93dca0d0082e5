"""Interrupted or killed in the middle of the work: files are as they were, or new and whole; work goes on.

Ctrl-C is raised at a chosen step of the work, in this process: no clock decides what is tested.  Sessions and
``watch``, which wait for something, are interrupted from outside in the tests of their own.
"""

import hashlib
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from cohort_outputs import cohort_folder
from command_line import (
    PACKAGES,
    QUICK,
    REPOSITORY,
    python,
    read_json,
    run,
    same_run,
    start,
    until,
    write_log,
)
from identify_stand_ins import of_prior
from rendered_tissues import write_bundles
from test_cli_design import RECIPE

SAID = "tissueid: interrupted; what was finished is kept\n"
#: Command, and at which report of its progress the signal comes.
AT_A_STEP: list[tuple[tuple[str, ...], int]] = [
    (("fit", "lab", "-o", "out", *QUICK), 1),
    (("fit", "lab", "-o", "out", *QUICK), 4),
    (("cohort", "heads"), 1),
    (("inspect", "lab"), 1),
    (("design", "a.h5", "--machine", "paper-a", "-o", "plan"), 2),
    (("compare", "a.h5", "b.h5", "-o", "old.json"), 2),
    (("rupture", "ruptures", "-o", "rup", "--criterion", "work"), 3),
    (("calibrate", "recipe.toml", "-o", "cal", "--simulations", "20"), 8),
    (("reproduce", "pires", "-o", "rep"), 1),
    (("reproduce", "sadeghnejad", "-o", "rep"), 1),
]
#: Command without a progress display, and the function in which the signal comes.
IN_A_FUNCTION: list[tuple[tuple[str, ...], str]] = [
    (("control", "a.h5"), "tissueid.rendering.control.document.as_document"),
    (("export", "out", "-o", "old.json"), "tissueid.store.results.read_results"),
    (("report", "out"), "tissueid.store.results.read_results"),
    (("synth", "paper-a-22", "-o", "syn"), "tissueid.synth.write_set"),
    (("study", "init", "lab", "--force"), "tissueid.study.draft.draft_study"),
    (("study", "export", "lab", "--crate", "crate"), "tissueid.study.recordings.locate_study"),
    (("calibrate-frame", "lab/log.csv", "-o", "old.json"), "tissueid.study.calibrate_frame.calibrate_frame"),
    (("migrate", "out"), "tissueid.store.migrate.migrate_folder"),
    (("doctor", "--warm"), "tissueid.doctor.warm"),
]


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ctrl-c")
    write_log(folder / "lab" / "log.csv")
    write_log(folder / "lab" / "second.csv", label="other")
    run("study", "init", folder / "lab", "-q", code=0)
    run("fit", folder / "lab", "-o", folder / "out", "-q", *QUICK, code=0)
    cohort_folder(folder / "heads", 3)
    (folder / "recipe.toml").write_text(RECIPE, encoding="utf-8")
    (folder / "ruptures").mkdir()
    for path in (REPOSITORY / "datasets_synthetic" / "rupture-18").glob("rupture-01-*.csv"):
        shutil.copy(path, folder / "ruptures")
    write_bundles(folder)
    (folder / "old.json").write_text("what was here before", encoding="ascii")
    return folder


@pytest.fixture
def place(prepared, tmp_path, monkeypatch):
    """A copy of the prepared folder to work in; Ctrl-C is what it is in a shell."""
    shutil.copytree(prepared, tmp_path / "here", symlinks=True)
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr("tissueid.selfcheck.tissue.identify", of_prior)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield tmp_path / "here"
    signal.signal(signal.SIGINT, before)


def interrupt_at(monkeypatch: pytest.MonkeyPatch, command: str, step: int) -> None:
    """Raise the signal at a report of the progress of a command."""
    done = [0]

    def report(_message: str, _done: int, _total: int) -> None:
        done[0] += 1
        if done[0] == step:
            signal.raise_signal(signal.SIGINT)

    @contextmanager
    def bar(*, show: bool) -> Iterator[Callable[[str, int, int], None]]:
        yield report

    monkeypatch.setattr(import_module(f"tissueid.cli.{command}_command"), "progress_bar", bar)


def contents(folder: Path) -> dict[str, str]:
    """Every visible file with its digest; what is hidden, and the index, is the state to go on from."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
        and path.name != "index.sqlite"
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    }


@pytest.mark.needs_jit
@pytest.mark.parametrize(("args", "step"), AT_A_STEP, ids=lambda value: str(value)[:40])
def test_at_a_step_of_the_work(place, monkeypatch, args, step):
    before = contents(place)
    interrupt_at(monkeypatch, args[0], step)
    ended = run(*args)
    # the empty line parts it from the ^C that a terminal shows
    assert (ended.code, ended.stdout, ended.stderr.lstrip("\n")) == (130, "", SAID)
    after = contents(place)
    assert {name: after[name] for name in before} == before
    # the run that stood there is whole
    assert run("validate", "out").code == 0
    new = set(after) - set(before)
    assert all(name.startswith("cal") for name in new), new


@pytest.mark.parametrize(("args", "function"), IN_A_FUNCTION, ids=lambda value: str(value)[:40])
def test_in_the_middle_of_a_function(place, monkeypatch, args, function):
    before = contents(place)

    monkeypatch.setattr(function, lambda *_, **__: signal.raise_signal(signal.SIGINT))
    ended = run(*args, code=130)
    assert ended.stderr.splitlines()[-1] + "\n" == SAID
    assert contents(place) == before


def test_an_interrupted_calibration_goes_on_where_it_was(place, monkeypatch):
    check, log = ("calibrate", "recipe.toml", "--simulations", "20", "-o"), place / "cal" / "calibrate.jsonl"
    with monkeypatch.context() as patched:
        interrupt_at(patched, "calibrate", 8)
        run(*check, "cal", code=130)
    kept = log.read_text(encoding="utf-8").splitlines()
    assert len(kept) > 1
    for out in ("cal", "whole"):
        run(*check, out, code={0, 4, 7})
    assert log.read_text(encoding="utf-8").splitlines()[: len(kept)] == kept
    found = [read_json(place / name / "calibrate.json") for name in ("cal", "whole")]
    for document in found:
        # a time is no result
        del document["simulations"]["median_seconds"]
    assert found[0] == found[1]


def test_an_interrupted_fit_keeps_its_finished_specimens(place, monkeypatch):
    fit = ("fit", "lab", "-o", "new", "--workers", "1", *QUICK)
    step = 0
    while not list((place / "new").rglob("specimens/*.h5")) and step < 40:
        step += 1
        with monkeypatch.context() as patched:
            interrupt_at(patched, "fit", step)
            assert run(*fit).code == 130, step
    (kept,) = (place / "new").rglob("specimens/*.h5")
    written = kept.stat().st_mtime_ns
    assert run(*fit).code == 0
    assert kept.stat().st_mtime_ns == written
    assert len(run("export", "new").json()["specimens"]) == 2
    assert run("validate", "new").code == 0


def test_a_scheduler_that_ends_the_job_is_heard_as_ctrl_c(place):
    with start("fit", "lab", "-o", "new", "-q", *QUICK) as process:
        until((place / "new" / ".runs").exists)
        process.terminate()
        assert process.wait(timeout=60) == 130
    run("fit", "lab", "-o", "new", "-q", *QUICK, code=0)


def test_while_it_is_still_being_loaded(tmp_path):
    # a module that is imported first of all, and in which the signal comes
    (tmp_path / "click").mkdir()
    (tmp_path / "click" / "__init__.py").write_text(
        "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nimport time\ntime.sleep(60)\n",
        encoding="ascii",
    )
    begun = "import signal; signal.signal(2, signal.default_int_handler)"
    code = f"{begun}; from tissueid.__main__ import start; start()"
    done = python("-c", code, check=False, PYTHONPATH=f"{tmp_path}:{PACKAGES}")
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "\ntissueid: interrupted; nothing was begun\n"


#: Options of two runs over the same logs, which give different numbers.
RUNS = (QUICK, ("--branches", "2", "--stiffness-degree", "0", "--sampler", "none"))


@pytest.fixture(scope="module")
def two_runs(tmp_path_factory):
    """A log, the folders that either run writes, and how long one takes in a process of its own [s]."""
    folder = tmp_path_factory.mktemp("kill")
    log, written = write_log(folder / "log.csv"), [folder / "0", folder / "1"]
    for out, options in zip(written, RUNS, strict=True):
        begin = time.monotonic()
        with start("fit", log, "-o", out, "-q", *options) as process:
            assert process.wait(timeout=120) in (0, 4)
        seconds = time.monotonic() - begin
    assert not same_run(*written)
    return log, written, seconds


@pytest.mark.parametrize(("kills", "seed"), [(3, 20), pytest.param(20, 21, marks=pytest.mark.slow)])
def test_fits_killed_at_random_moments_leave_the_old_run_or_the_new(two_runs, tmp_path, kills, seed):
    (log, written, seconds), out = two_runs, tmp_path
    rng = np.random.default_rng(seed)
    run("fit", log, "-o", out, "-q", *RUNS[0], code={0, 4})
    shown = 0
    for kill in range(kills):
        # half of the kills anywhere, half in the last third, where the files are written
        begin = 0.0 if kill % 2 else 0.67
        other = 1 - shown
        with start("fit", log, "-o", out, "-q", *RUNS[other]) as process:
            time.sleep(seconds * float(rng.uniform(begin, 1.05)))
            process.kill()
        run("validate", out, code=0)
        (shown,) = (number for number, whole in enumerate(written) if same_run(out, whole))
        bundle = run("export", out).json()["specimens"][0]["model"]["branches"]
        assert bundle == shown + 1
    # the folder is of use afterwards
    run("fit", log, "-o", out, "-q", *RUNS[0], code={0, 4})
    assert same_run(out, written[0])
    assert len(list((out / ".runs").iterdir())) == 1
    assert not list(out.glob(".tmp-*"))
