"""Whatever is handed in, the answer is one clear message and the right code: never a traceback."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import QUICK, log_text, read_json, run, start, write_log


def rows_with(change: Callable[[int, str], str]) -> bytes:
    lines = log_text().splitlines()
    return "\n".join(change(number, line) for number, line in enumerate(lines, 1)).encode()


def emptied_workbook() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("readme.txt", "nothing")
    return stream.getvalue()


def with_cell(cell: str) -> bytes:
    """The log with another force on line 40."""
    return rows_with(lambda n, line: line.rsplit(",", 1)[0] + cell if n == 40 else line)


#: Files with a bad cell on line 40.
BAD_CELLS: dict[str, bytes] = {
    "nan.csv": with_cell(",NaN"),
    "infinite.csv": with_cell(",1e999"),
    "text.csv": with_cell(",oops"),
    "ragged.csv": with_cell(""),
    "backwards.csv": rows_with(lambda n, line: "0.0" + line[line.index(",") :] if n == 40 else line),
}
BAD_FILES: dict[str, bytes] = BAD_CELLS | {
    "binary.csv": bytes(range(256)) * 40,
    "empty.csv": b"",
    "blank.csv": b"\n\n \n",
    "bom-only.csv": b"\xef\xbb\xbf",
    "nulls.csv": bytes(4000),
    "prose.csv": b"Dear colleague,\nthe data are on the other disk.\n",
    "header-only.csv": log_text().encode()[:80],
    "one-row.csv": b"Time,Extension,Load\n(sec),(mm),(N)\n0.0,0.0,0.0\n",
    "unknown-unit.csv": log_text().replace("(N)", "(zorkmid)").encode(),
    "wrong-unit.csv": log_text().replace("(N)", "(mm)").encode(),
    "html.csv": b"<html><body><table><tr><td>1</td></tr></table></body></html>",
    "image.png": b"\x89PNG\r\n\x1a\n" + bytes(500),
    "not-a-workbook.xlsx": b"PK\x03\x04" + bytes(200),
    "empty.xlsx": emptied_workbook(),
    "text-as.xlsx": log_text().encode()[:60],
    "no-motion.csv": b"Time,Extension,Load\n(sec),(mm),(N)\n"
    + b"".join(b"%.2f,1.0,2.0\n" % (0.01 * i) for i in range(300)),
    "three-rows.csv": b"Time,Extension,Load\n(sec),(mm),(N)\n0.0,0.0,0.0\n0.1,0.1,0.1\n0.2,0.2,0.3\n",
    "zeros.csv": b"Time,Extension,Load\n(sec),(mm),(N)\n" + b"0.0,0.0,0.0\n" * 50,
    "one-time.csv": b"Time,Extension,Load\n(sec),(mm),(N)\n"
    + b"".join(b"1.0,%.2f,%.2f\n" % (0.01 * i, 0.02 * i) for i in range(50)),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_is_told_and_is_no_bug(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(BAD_FILES[name])
    told, *_ = run("inspect", path, "--json", code=3 if name in BAD_CELLS else {0, 3}).json()
    assert name not in BAD_CELLS or told["error"]["line"] == 40
    # what can be read but not fitted is described by inspect and refused by fit
    fitted = run("fit", path, "-o", tmp_path / "out", *QUICK, code={3, 4}, said=name)
    assert not (tmp_path / "out" / "identification.json").exists() or fitted.code == 4


def test_sound_files_are_fitted_and_every_bad_one_among_them_is_named_with_its_reason(tmp_path):
    folder = tmp_path / "lab"
    for name, times in (("one", 1.0), ("two", 1.02), ("other", 1.3)):
        write_log(folder / f"{name}.csv", label="other" if name == "other" else "liver", force_times=times)
    # a picture in a folder is nothing that was meant
    bad = {f"bad-{name}": content for name, content in BAD_FILES.items() if not name.endswith(".png")}
    for name, content in bad.items():
        (folder / name).write_bytes(content)
    ended = run("fit", folder, "-o", tmp_path / "out", *QUICK, code=7)
    document = read_json(tmp_path / "out" / "identification.json")
    assert {one["specimen"]: len(one["trials"]) for one in document["specimens"]} == {"liver": 2, "other": 1}
    refused = {Path(one["path"]).name: one["error"] for one in document["refused"]}
    assert set(refused) == set(bad)
    for name, error in refused.items():
        (said,) = (line for line in ended.stderr.splitlines() if f"/{name}" in line)
        assert said.startswith(f"refused ({error['code']})")
        assert error["message"] in said


@pytest.mark.parametrize(
    ("args", "codes"),
    [
        (["--columns", "force=Druck"], {3}),
        (["--columns", "force=#9"], {3}),
        (["--columns", "time=Load,force=Time"], {3}),
        (["--units", "time=mm"], {2}),
        (["--contact", "500"], {3}),
        pytest.param(["--contact", "-500"], {0, 3, 4}, marks=pytest.mark.slow),
        (["--contact", "1e300"], {2}),
        (["--contact", "-1e300"], {2}),
        (["--contact", "-9999"], {0, 3, 4}),
        (["--compression", "negative"], {0, 3, 4}),
        (["--recipe", "testxpert-workbook"], {3}),
        (["--specimen-by", "zzz"], {2}),
    ],
)
def test_a_doubtful_option_ends_cleanly(tmp_path, args, codes):
    log = write_log(tmp_path / "log.csv")
    ended = run("fit", log, *args, "-o", tmp_path / "out", *QUICK, code=codes)
    assert ended.stderr.strip() or ended.code == 0


def test_an_output_folder_that_is_a_file_or_below_one_is_refused(tmp_path):
    log = write_log(tmp_path / "log.csv")
    for args in (["fit", log, *QUICK], ["synth", "paper-a-hold-100Hz"]):
        run(*args, "-o", log, code=2, said="is a file")
        run(*args, "-o", log / "out", code=2)
    assert log.read_text(encoding="ascii") == log_text()


def test_results_can_only_be_written_where_there_is_a_folder(fitted_log, tmp_path):
    out, log = fitted_log / "out", fitted_log / "lab" / "log.csv"
    for command in (("export", out, "-o"), ("report", out, "-o"), ("inspect", log, "--html")):
        run(*command, tmp_path / "none" / "file", code=2, said="can't be written")


@pytest.mark.parametrize("content", ["", "{", "[]", "null", '{"schema": "tissueid/identification/1"}'])
def test_a_spoilt_set_is_refused_by_every_command(fitted_log, content):
    out = fitted_log / "out"
    for path in (out / "identification.json", *out.glob(".runs/*/identification.json")):
        path.write_text(content, encoding="utf-8")
    for command in ("validate", "report", "export"):
        assert run(command, out).code == 6, command


def test_a_second_fit_repairs_a_spoilt_set(fitted_log):
    out, log = fitted_log / "out", fitted_log / "lab" / "log.csv"
    (out / "bundle.h5").write_bytes(b"spoilt")
    assert run("validate", out).code == 6
    run("fit", log, "-o", out, *QUICK)
    assert run("validate", out).code == 0


def test_an_output_inside_the_data_folder_is_not_read_as_data(tmp_path):
    write_log(tmp_path / "lab" / "log.csv")
    for _ in range(2):
        ended = run("fit", tmp_path / "lab", "-o", tmp_path / "lab" / "out", "--json", *QUICK, code={0, 4})
        assert len(ended.json()["provenance"]["inputs"]) == 1


def test_a_file_named_twice_is_read_once(tmp_path):
    log = write_log(tmp_path / "lab" / "log.csv")
    assert len(run("inspect", log, tmp_path / "lab", log, "--json").json()) == 1


def test_a_file_that_changes_between_the_passes_is_refused(tmp_path, monkeypatch):
    from tissueid import collection, pipeline

    monkeypatch.setattr(collection, "CACHE_BYTES", 0)
    first = write_log(tmp_path / "a.csv")
    write_log(tmp_path / "b.csv", force_times=1.1)
    real = pipeline.fit_with_state

    def changing(*args: object, **options: object) -> object:
        write_log(first, force_times=2.0)
        return real(*args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(pipeline, "fit_with_state", changing)
    said = ("a.csv", "changed while it was being fitted")
    run("fit", first, tmp_path / "b.csv", "-o", tmp_path / "out", *QUICK, code=3, said=said)


@pytest.mark.parametrize("args", [["--help"], ["inspect", "LOG"], ["inspect", "LOG", "--json"]])
def test_a_closed_pipe_is_no_error(tmp_path, args):
    log = write_log(tmp_path / "log.csv")
    process = start(*[str(log) if arg == "LOG" else arg for arg in args])
    assert process.stdout is not None
    assert process.stderr is not None
    # closed before a byte is written, as by a reader that has seen enough
    process.stdout.close()
    with process.stderr as stream:
        said = stream.read()
    assert (process.wait(timeout=60), said) == (0, "")
