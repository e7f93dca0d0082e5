"""An output folder shows the old set or the new one, whatever happens while it is written.

Names of specimens become file names that every system takes.
"""

import contextlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from fit_factory import identification, specimen_fit, write_results
from posterior_factory import sampled
from set_writer import commit

from tissueid.cli.output import write_output
from tissueid.errors import BundleError, UsageError
from tissueid.result import Identification
from tissueid.store import outputs as outputs_module
from tissueid.store.bundle import load_bundle
from tissueid.store.files import REPORT, bundle_names, replacing, safe_name, write_file
from tissueid.store.outputs import OutputSet, complete_refresh, current_run
from tissueid.store.results import load_identification, output_problems, read_results, validate_outputs

WRITER = Path(__file__).with_name("set_writer.py")
ALWAYS = ("identification.json", "curves.h5", "report.html")


def write(out: Path, *specimens: str, report: str = "<p>report</p>") -> Identification:
    run = identification([specimen_fit(name, trials=1, samples=40) for name in specimens])
    return commit(out, run, **{REPORT: report.encode()})


def public(out: Path) -> set[str]:
    return {path.name for path in out.iterdir() if not path.name.startswith(".")}


def test_a_committed_set_is_public_whole_valid_and_read_back_from_the_folder_alone(tmp_path):
    out = tmp_path / "new" / "out"
    run = write(out, "kidney 3", "b")
    assert public(out) == {*ALWAYS, "bundle-kidney_3.h5", "bundle-b.h5"}
    validate_outputs(out)
    document, curves, posteriors = read_results(out)
    assert posteriors == ()
    assert [entry.specimen for entry in document.specimens] == ["kidney 3", "b"]
    for entry, fit in zip(curves, run.specimens, strict=True):
        expected = fit.trials[0].curve
        for name in ("time_s", "depth_mm", "force_N", "model_N", "fitted"):
            assert np.array_equal(getattr(entry.curve, name), getattr(expected, name)), name


def test_the_same_run_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        fits = [sampled(specimen_fit("x", trials=1, samples=40)), specimen_fit("y", trials=1, samples=40)]
        commit(tmp_path / name, identification(fits))
    assert len(public(tmp_path / "a")) == 5
    for path in (tmp_path / "a").glob("[!.]*"):
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes(), path.name


def test_a_document_of_another_version_is_refused_with_its_place_and_a_way_out(tmp_path):
    write(tmp_path, "old")
    path = tmp_path / "identification.json"
    path.write_text(path.read_text().replace('"selection": ', '"model_comparison": [], "selection": ', 1))
    with pytest.raises(BundleError, match=r"/specimens/0: .*`model_comparison`; run `tissueid fit` again$"):
        load_identification(path)


def test_names_of_the_old_set_disappear_and_files_of_others_stay(tmp_path):
    write(tmp_path, "only")
    assert public(tmp_path) == {*ALWAYS, "bundle-only.h5", "bundle.h5"}
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "old.h5").write_text("checkpoint")
    write(tmp_path, "p", "q")
    assert public(tmp_path) == {*ALWAYS, "bundle-p.h5", "bundle-q.h5", "notes.txt", "old.h5"}
    assert len(list((tmp_path / ".runs").iterdir())) == 1


def test_a_run_that_fails_leaves_the_old_set(tmp_path):
    write(tmp_path, "old")

    def stop_half_way() -> None:
        with OutputSet(tmp_path) as outputs:
            outputs.write("identification.json", b"{}")
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        stop_half_way()
    validate_outputs(tmp_path)
    assert read_results(tmp_path)[0].specimens[0].specimen == "old"


def test_an_interrupt_while_the_folder_is_made_leaves_none(tmp_path, monkeypatch):
    write(tmp_path, "old")
    make = Path.mkdir

    def interrupted(folder: Path, *args: object, **kwargs: object) -> None:
        make(folder, *args, **kwargs)
        if folder.parent.name == ".runs":
            raise KeyboardInterrupt

    monkeypatch.setattr(Path, "mkdir", interrupted)
    with pytest.raises(KeyboardInterrupt), OutputSet(tmp_path):
        pass
    monkeypatch.undo()
    assert len(list((tmp_path / ".runs").iterdir())) == 1
    # nor is the folder held
    write(tmp_path, "new")


def test_a_finished_refresh_touches_nothing_and_carrying_over_replaces_the_report_alone(tmp_path):
    write(tmp_path, "a")
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    complete_refresh(tmp_path)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before
    write(tmp_path, "a")
    numbers = (tmp_path / "identification.json").read_bytes()
    with OutputSet(tmp_path) as outputs:
        outputs.carry_over()
        outputs.write(REPORT, b"<p>again</p>")
        outputs.commit()
    validate_outputs(tmp_path)
    assert (tmp_path / "identification.json").read_bytes() == numbers
    assert (tmp_path / REPORT).read_bytes() == b"<p>again</p>"


def test_a_file_cannot_leave_its_set(tmp_path):
    with OutputSet(tmp_path) as outputs:
        for name in ("../x", "a/b", ".hidden", "manifest.json", ""):
            with pytest.raises(ValueError, match="public name"):
                outputs.path(name)


def test_a_second_writer_is_refused_with_the_name_of_the_first_while_that_lives(tmp_path):
    busy = pytest.raises(BundleError, match=f"process {os.getpid()} on .* is writing here")
    with OutputSet(tmp_path):
        with busy, OutputSet(tmp_path):
            pass
        # a reader is not kept out
        complete_refresh(tmp_path)
    # what a dead process left is no lock
    (tmp_path / ".lock").write_text(json.dumps({"pid": os.getpid(), "host": "elsewhere"}))
    write(tmp_path, "after")
    validate_outputs(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="can't be made a folder"), OutputSet(tmp_path / "file"):
        pass


def test_a_mixed_set_is_refused(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    write(one, "a")
    run = identification([specimen_fit("a", trials=2, samples=50, identified=False, seed=9)])
    commit(two, run, **{REPORT: b"<p>other</p>"})
    for name in ("identification.json", "bundle-a.h5", "curves.h5", "report.html"):
        own = (one / name).read_bytes()
        (one / name).write_bytes((two / name).read_bytes())
        with pytest.raises(BundleError, match=f"{name} is not the one this run wrote"):
            validate_outputs(one)
        (one / name).write_bytes(own)
    validate_outputs(one)


def test_a_bundle_of_other_numbers_is_told_even_where_the_manifest_agrees(tmp_path):
    run = identification([specimen_fit("a", trials=1, samples=40)])
    with OutputSet(tmp_path) as outputs:
        write_results(outputs, run)
        document = json.loads(outputs.path("identification.json").read_bytes())
        document["specimens"][0]["sigma_N"] = 0.7
        outputs.write("identification.json", json.dumps(document).encode())
        outputs.commit()
    assert output_problems(tmp_path) == [
        "bundle-a.h5 and identification.json differ in sigma_N",
        "bundle.h5 and identification.json differ in sigma_N",
    ]


def test_a_missing_and_a_foreign_bundle_are_told(tmp_path):
    write(tmp_path, "a", "b")
    (tmp_path / "bundle-c.h5").write_bytes((tmp_path / "bundle-a.h5").read_bytes())
    assert output_problems(tmp_path) == ["bundle-c.h5 belongs to no specimen of identification.json"]
    (tmp_path / "bundle-a.h5").unlink()
    assert any("bundle-a.h5 is missing" in problem for problem in output_problems(tmp_path))


def test_a_damaged_commit_mark_is_refused(tmp_path):
    write(tmp_path, "a")
    for content in ("", "000099\n", "../..\n", "é"):
        (tmp_path / ".current").write_bytes(content.encode())
        with pytest.raises(BundleError, match="current run"):
            validate_outputs(tmp_path)


def whole_sets(out: Path, delays: list[float]) -> int:
    """Kill the writer after each delay; how many times the folder held one whole set, never an older one."""
    number, last, whole = 1, 0, 0
    environment = os.environ | {"PYTHONPATH": str(WRITER.parents[1])}
    for delay in delays:
        words = [sys.executable, WRITER, out, str(number)]
        writer = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment)
        finished = int(writer.stdout.readline())
        time.sleep(delay)
        writer.kill()
        finished = max([finished, *(int(line) for line in writer.stdout.read().split("\n") if line)])
        writer.stdout.close()
        writer.wait()
        validate_outputs(out)
        document, *_ = read_results(out)
        shown = {int(entry.specimen.split("-")[0][1:]) for entry in document.specimens}
        assert len(shown) == 1
        (seen,) = shown
        # committed sets are never lost; the set being written may have been committed before it was counted
        assert finished <= seen <= finished + 1
        assert seen >= last
        assert (out / REPORT).read_text() == f"<p>set {seen}</p>"
        assert {load_bundle(path).specimen.split("-")[0] for path in out.glob("bundle*.h5")} == {f"s{seen}"}
        # a kill within the commit itself leaves the mark that was to be renamed; the next commit sweeps it up
        assert {path.name for path in out.glob(".tmp-*")} <= {".tmp-.current"}
        number, last, whole = seen + 1, seen, whole + 1
    write(out, "after")
    assert not list(out.glob(".tmp-*"))
    return whole


@pytest.mark.parametrize("kills", [6, pytest.param(20, marks=pytest.mark.slow)])
def test_a_kill_at_any_moment_leaves_a_whole_set(tmp_path, kills):
    # one set takes some 50 ms to write: the delays cover several
    delays = np.random.default_rng(kills).uniform(0.0, 0.25, kills).tolist()
    assert whole_sets(tmp_path, delays) == kills


def test_every_step_of_a_commit_may_be_the_last(tmp_path, monkeypatch):
    """Stop before each rename of a commit in turn: the systematic form of the kill test."""
    real = outputs_module.replace_file
    for stop in range(16):
        out = tmp_path / str(stop)
        write(out, "old")
        done: list[Path] = []

        def failing(temporary: Path, target: Path, *, done: list[Path] = done, stop: int = stop) -> None:
            if len(done) == stop:
                raise KeyboardInterrupt
            done.append(target)
            real(temporary, target)

        with monkeypatch.context() as patch:
            patch.setattr(outputs_module, "replace_file", failing)
            patch.setattr("tissueid.store.files.replace_file", failing)
            with contextlib.suppress(KeyboardInterrupt):
                write(out, "new")
        committed = (out / ".current") in done
        # what reads the folder next finishes what was begun
        validate_outputs(out)
        shown = "new" if committed else "old"
        assert read_results(out)[0].specimens[0].specimen == shown
        assert public(out) == {*ALWAYS, f"bundle-{shown}.h5", "bundle.h5"}
    run = current_run(out)
    assert run is not None
    assert committed, "the last stop must lie behind the commit"


def test_a_folder_without_a_run_is_told_once_with_the_way_out(tmp_path):
    told = f"{tmp_path}: holds no finished run; `tissueid fit ... -o {tmp_path}` makes one"
    with pytest.raises(BundleError) as caught:
        validate_outputs(tmp_path)
    assert caught.value.message == told


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("kidney 3", "kidney_3"),
        ("a/b\\c:d*e", "a_b_c_d_e"),
        ("../../etc", "etc"),
        ("CON", "CON_"),
        ("aux.csv", "aux.csv_"),
        ("com1", "com1_"),
        ("", "specimen"),
        ("...", "specimen"),
        ("肾脏", "肾脏"),
        ("end. ", "end"),
        # eighty bytes, in whole characters
        ("é" * 300, "é" * 40),
    ],
)
def test_a_name_is_made_safe(name, expected):
    assert safe_name(name) == expected


def test_names_that_meet_without_case_are_kept_apart():
    names = bundle_names(["Liver", "liver", "a/b", "a_b", "spleen"])
    assert names["spleen"] == "bundle-spleen.h5"
    assert len({name.casefold() for name in names.values()}) == 5
    assert bundle_names(["a b", "a_b"]) == bundle_names(["a_b", "a b"])


def test_folders_and_pipes_are_never_replaced_and_links_stay(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in (".", ".."):
        with pytest.raises(OSError, match=r"busy|directory"):
            write_file(Path(name), b"")
    assert list(tmp_path.iterdir()) == []
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reading = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_file(pipe, b"whole")
    assert os.read(reading, 99) == b"whole"
    os.close(reading)
    with pytest.raises(OSError, match="it is no file"), replacing(pipe):
        pass
    assert pipe.is_fifo()
    real, link = tmp_path / "real", tmp_path / "link"
    real.write_bytes(b"old")
    link.symlink_to(real)
    write_output(link, b"new")
    assert link.is_symlink()
    assert real.read_bytes() == b"new"
