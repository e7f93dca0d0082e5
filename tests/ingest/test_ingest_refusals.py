"""Files that are no recordings are refused by name and reason; tables in HTML and XML; readers of others."""

import importlib
import json
import re
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from ingest_files import codes, put, read, refusal, workbook

from tissueid.errors import InputError, UsageError
from tissueid.ingest import (
    REFUSAL_CODES,
    ReadOptions,
    find_inputs,
    forget_readers,
    match_of,
    read_each,
    read_trials,
    reader_faults,
)
from tissueid.ingest.refusals import Place

GOOD = "Time,Extension,Load\n(s),(mm),(N)\n0.0,0.0,0.1\n0.1,0.5,0.2\n0.2,1.0,0.4\n"


def refused(path: Path) -> InputError:
    item = refusal(path)
    assert item.code in REFUSAL_CODES
    assert item.path == str(path)
    return item


PNG = b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 20
RESULTS = "Specimen,Maximum load (N),Modulus (MPa)\nA,12.5,3.1\nB,13.5,3.4\nC,11.9,2.9\n"

WRONG = {
    "png": (PNG, "not_an_export", "PNG"),
    "NUL bytes": (bytes(4000), "empty_file", "empty"),
    "empty": (b"", "empty_file", "empty"),
    "byte order mark": (b"\xef\xbb\xbf", "empty_file", "empty"),
    "blank lines": (b"\r\n\r\n \r\n", "empty_file", "empty"),
    "json lines": (b'{"t": 0.1, "F": 1}\n' * 40, "not_an_export", "lines=True"),
    "json": (json.dumps({"time": [0, 1], "force": [1, 2]}).encode(), "not_an_export", "JSON"),
    "html": (b"<!DOCTYPE html><html><body>1,2,3</body></html>", "not_an_export", "HTML"),
    "prose": (b"Dear colleague,\n\nplease find the data, as agreed.\n", "not_an_export", "Dear"),
    "random bytes": (bytes((i * 7919 + i * i) % 256 for i in range(5000)), "not_an_export", "binary"),
    "NUL in a cell": (GOOD.replace("0.5", "0\x005").encode(), "not_an_export", "binary"),
    "one long line": (b"1" * 200_000, "not_an_export", "line"),
    "letters": (b"Time,x,u,F\n0,1,2,3\n1,2,3,4\n", "no_columns", "'x', 'u'"),
    "results only": (RESULTS.encode(), "no_columns", "Maximum load (N)"),
    "names without rows": (b"Time,Extension,Load\n(s),(mm),(N)\n", "no_rows", "no row"),
    "one row": (b"Time,Extension,Load\n(s),(mm),(N)\n0.0,1.0,2.0\n", "no_rows", "1 rows"),
    "zip without workbook": (b"PK\x03\x04" + b"\0" * 60, "unreadable_workbook", "workbook"),
    "broken xls": (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + b"\0" * 600, "unreadable_workbook", "workbook"),
    "truncated UTF-16": (b"\xff\xfe" + GOOD.encode("utf-16-le")[:-1], "not_an_export", "UTF-16"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_files_are_refused_with_their_kind(tmp_path, name):
    data, code, word = WRONG[name]
    error = refused(put(tmp_path / f"{name}.csv", data))
    assert error.code == code
    assert word in error.message


def test_a_column_the_user_named_must_exist_once(tmp_path):
    path = put(tmp_path / "a.csv", "Time,L,L\n0,1,2\n1,2,3\n")
    for wanted, word in (("X", "'L'"), ("L", "#2, #3")):
        error = refusal(path, ReadOptions(columns={"displacement": wanted, "force": "#3"}))
        assert error.code == "column_not_found"
        assert word in error.message


def test_missing_paths_and_empty_directories(tmp_path):
    with pytest.raises(UsageError, match=r"nowhere\.csv"):
        find_inputs([tmp_path / "nowhere.csv"])
    (tmp_path / "notes.txt").write_text("the operator was ill")
    with pytest.raises(InputError) as caught:
        read_trials(tmp_path)
    assert caught.value.code == "no_recording"
    assert refused(tmp_path / "gone.csv").code == "unreadable_file"
    assert refused(tmp_path).code == "unreadable_file"


def test_directories_in_natural_order_without_hidden_files_and_own_output(tmp_path):
    hidden = (".hidden.csv", "~$log.xlsx", "out/log_3.csv")
    for name in ("log_10.csv", "log_2.CSV", *hidden, "sub/log_1.txt", "x.md"):
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(GOOD)
    (tmp_path / "out" / "identification.json").write_text("{}")
    names = [path.relative_to(tmp_path).as_posix() for path in find_inputs([tmp_path])]
    assert names == ["log_2.CSV", "log_10.csv", "sub/log_1.txt"]
    assert find_inputs([tmp_path / "x.md", tmp_path / "x.md"]) == [tmp_path / "x.md"]


def trial_sheet(name: str, rows: list[list[object]] | None = None) -> list[list[object]]:
    head = [[name] * 3, ["Prüfzeit", "Standardkraft", "Standardweg"], ["s", "N", "mm"]]
    return head + (rows or [[0.1 * i, 2.0 * i, 0.5 * i] for i in range(20)])


def test_a_bad_sheet_never_stops_the_others(tmp_path):
    bad = [[0.0, 1.0, 2.0], [0.1, "1,5", 2.1], [0.2, 1.6, 2.2]]
    sheets = {
        "Parameter": [["Titel", "", "x"]],
        "A 1": trial_sheet("A 1"),
        "A 2": trial_sheet("A 2", bad),
        "A 3": trial_sheet("A 3", [[0.0, 1.0, 2.0], [0.1, None, 2.1], [0.2, 1.6, 2.2]]),
        "A 4": trial_sheet("A 4", [[0.0, 1.0, 2.0], [0.2, 1.1, 2.1], [0.1, 1.6, 2.2]]),
        "A 5": trial_sheet("A 5")[:3],
        "A 6": trial_sheet("A 6"),
    }
    items = list(read_each(workbook(tmp_path / "t.xlsx", sheets)))
    found = [
        (item.sheet, item.code, item.line, item.column) if isinstance(item, InputError) else item.source.sheet
        for item in items
    ]
    assert found == [
        "A 1", ("A 2", "text_in_numbers", 5, 2), ("A 3", "empty_cell", 5, 2), ("A 4", "time_backwards", 6, 1),
        ("A 5", "no_rows", 3, None), "A 6",
    ]  # fmt: skip
    good = items[0]
    assert good.displacement_mm[3] == 1.5
    assert good.specimen == "A 1"


def test_sheets_that_share_a_test_name_stay_apart(tmp_path):
    path = workbook(
        tmp_path / "t.xlsx", {"x": trial_sheet("A"), "y": trial_sheet("A"), "z": trial_sheet("Probe 1")}
    )
    assert [trial.specimen for trial in read_trials(path)] == [f"{path}::{sheet}" for sheet in "xyz"]


def test_a_workbook_without_a_trial_says_what_it_saw(tmp_path):
    path = workbook(
        tmp_path / "t.xlsx", {"Results": [["", "Fmax", "dL"], *([f"s{i}", 1.0, 2.0] for i in range(5))]}
    )
    error = refused(path)
    assert error.code == "no_trial_sheet"
    assert "Fmax" in error.message


def test_recipe_says_why_and_can_be_forced(tmp_path):
    path = put(tmp_path / "a.csv", GOOD)
    match = match_of(path)
    assert match.recipe.key == "bluehill-csv"
    assert "brackets" in match.reason
    trial = read(path, ReadOptions(recipe="columns"))
    assert trial.source.recipe == "columns"
    with pytest.raises(UsageError, match="bluehill-csv"):
        list(read_each(path, ReadOptions(recipe="nonsense")))


ROW = "0.{},0.0{},1.{},2.{}\n"
RESULTS = 'Test\nSample,"Modulus (MPa)","Yield (N)","Peak (N)","Note"\n1,5.1,2.2,3.3,"A 1"\n'


@pytest.mark.parametrize(
    ("text", "options", "says"),
    [
        # a force is no displacement, whatever its number is
        (f"Force_X,Force_Y,Force_Z,Torque_X\n{ROW}", {"columns": {"time": "9Hz"}}, "9Hz,displacement=NAME"),
        ("Time (s),XDisp (um),YDisp (um),Load (N)\n" + ROW, {}, "may be 'XDisp (um)' or 'YDisp (um)'"),
        ("time_s,position_steps,force_N,c\n" + ROW, {}, "export it as mm, calibrated"),
        ("0.{}\n", {}, "one number a line"),
        (RESULTS + "Mean,5.1,2.2,3.3\nMin,5.1,2.2,3.3\nMax,5.1,2.2,3.3\n", {}, "are results, not samples"),
    ],
)
def test_the_way_out_of_a_refusal_is_one(tmp_path, text, options, says):
    head, row = (text.removesuffix(ROW), ROW) if text.endswith(ROW) else ("", text)
    rows = "".join(row.format(*[k] * 4) for k in range(10, 60)) if "{}" in row else text
    assert says in refusal(put(tmp_path / "a.csv", head + rows), ReadOptions(**options)).message


@pytest.mark.parametrize(
    "wrong",
    [
        {"columns": {"stress": "a"}}, {"units": {"force": "mm"}}, {"specimen_by": "("}, {"delimiter": "::"},
        {"decimal": ";"},
    ],
)  # fmt: skip
def test_options_that_make_no_sense_are_usage_errors(wrong):
    with pytest.raises(UsageError):
        ReadOptions(**wrong)


def test_refusal_codes_are_closed():
    with pytest.raises(ValueError, match="unknown refusal code"):
        Place("a.csv").refusal("nonsense", "")


COUNT = 3_000  # more than the first 64 KiB
TABLE = [(k * 0.02, min(k * 0.01, 6.0), max(k * 0.01 - 1.0, 0.0) ** 2) for k in range(COUNT)]


def html() -> str:
    def row(cells: tuple[str, ...], tag: str = "td") -> str:
        return "<TR>" + "".join(f"<{tag} class=x>{cell}</{tag}>" for cell in cells) + "</TR>\n"

    names = row(("Time (s)", "Weg (µm)", "Load (N)"), "th")
    body = "".join(row((f"{t:.4f}", f"<b>{1e3 * x:.1f}</b>", f"{f:.3f}")) for t, x, f in TABLE)
    style = "<style>td {mso-number-format:1,2,3}</style><title>1 2 3</title>"
    return f"<html><head>{style}</head><body><table border=1>{names}{body}</table></body></html>"


def xml(indexed: bool) -> str:
    def row(cells: tuple[object, ...], kind: str) -> str:
        places = zip(["", ' ss:Index="3"' if indexed else "", ""], cells, strict=True)
        made = (f'<Cell{at}><Data ss:Type="{kind}">{cell}</Data></Cell>' for at, cell in places)
        return f"<Row>{''.join(made)}</Row>"

    names = row(("Time (s)", "Extension (mm)", "Load (N)"), "String")
    body = "".join(row((round(t, 4), round(x, 4), round(f, 4)), "Number") for t, x, f in TABLE)
    opening = '<?xml version="1.0"?>\n<Workbook xmlns:ss="urn:schemas-microsoft-com:office:spreadsheet">'
    sheet = f'<Worksheet ss:Name="S"><Table><Column/>{names}{body}</Table></Worksheet>'
    return f"{opening}<DocumentProperties><Title>a</Title></DocumentProperties>{sheet}</Workbook>"


@pytest.mark.parametrize("made", [html, partial(xml, indexed=False), partial(xml, indexed=True)])
@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_the_table_of_a_page_or_of_the_old_xml_is_read_with_its_empty_columns(tmp_path, made, encoding):
    path = put(tmp_path / "a.xls", made(), encoding)
    assert find_inputs([tmp_path]) == [path]
    trial = read(path)
    assert codes(trial) == []
    assert trial.time_s.size == COUNT
    assert (trial.displacement_mm[250], trial.force_N[250]) == pytest.approx((2.5, 2.25))


def test_a_number_that_a_page_damaged_is_refused(tmp_path: Path) -> None:
    text = html().replace(">2.250<", ">2.2.50<")
    assert refusal(put(tmp_path / "a.xls", text)).code == "damaged_number"


@pytest.mark.parametrize("size", [10, 100_000])
def test_a_page_without_a_table_is_no_export(tmp_path: Path, size: int) -> None:
    error = refusal(put(tmp_path / "a.xls", "<html><body>" + "<p>1,2,3</p>\n" * size + "</body></html>"))
    assert error.code == "not_an_export"
    assert "HTML" in error.message


DOCUMENT = Path(__file__).parents[2] / "docs" / "readers.md"
INDENTO = "INDENTO 1\nsample=A 7\nspeed=0.5\nms um mN\n0 0 0.5\n10 5 2.5\n20 10 6.5\n"
BARE = "Time,Extension,Load\n(s),(mm),(N)\n0.0,0.0,0.1\n0.1,0.5,0.2\n0.2,1.0,0.4\n"


def example() -> str:
    """The module printed in the document: what is documented is what is tested."""
    (code,) = re.findall(r"```python\n(# indento\.py\n.*?)```", DOCUMENT.read_text(), re.DOTALL)
    return str(code)


def install(folder: Path, name: str, module: str) -> None:
    """A distribution as an installer leaves it: a module, and its metadata with the entry point."""
    (folder / f"{name}.py").write_text(module)
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[tissueid.readers]\n{name} = {name}:RECIPE\n")
    forget_readers()


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    before = set(sys.modules)
    forget_readers()
    yield folder
    forget_readers()
    for name in set(sys.modules) - before:
        if (folder / f"{name}.py").exists():
            del sys.modules[name]
    importlib.invalidate_caches()


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return put(tmp_path / "synthetic.indento", INDENTO)


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    return put(tmp_path / "synthetic.csv", BARE)


def test_the_worked_example_reads_a_file_that_nothing_else_knows(site: Path, log: Path) -> None:
    refusal(log)
    install(site, "indento", example())
    trial = read(log)
    assert trial.time_s.tolist() == [0.0, 0.01, 0.02]
    assert trial.displacement_mm.tolist() == [0.0, 0.005, 0.01]
    # parse, factor, product: a rounding each
    assert trial.force_N.tolist() == pytest.approx([0.0005, 0.0025, 0.0065], rel=5e-16)
    assert trial.specimen == "A 7"
    assert trial.protocol.speed_mm_s == 0.5
    assert (trial.source.recipe, trial.source.recipe_reason) == ("indento", "the file begins INDENTO")
    assert reader_faults() == ()
    assert match_of(log, ReadOptions(recipe="indento")).recipe.key == "indento"
    with pytest.raises(UsageError, match="indento"):
        match_of(log, ReadOptions(recipe="other"))
    log.write_text(INDENTO.replace("10 5 2.5", "10 5,5 2.5"))
    error = refusal(log)
    assert (error.code, error.line, error.column) == ("inconsistent_decimal", 6, 2)


TAKES_OUR_KEY = """
from tissueid.ingest import Recipe
RECIPE = Recipe('bluehill-csv', 'x', lambda file: (1.0, 'mine'), lambda file: iter(()))
"""
BREAKS_AT_A_LOOK = """
from tissueid.ingest import Recipe
def detect(file):
    raise KeyError('gone')
RECIPE = Recipe('breaks', 'x', detect, lambda file: iter(()))
"""
#: A module, and words of the fault that is told of it.
BROKEN = {
    "does not import": ("import no_such_module_anywhere\n", "broken_reader", "ModuleNotFoundError"),
    "is no Python": ("def (:\n", "broken_reader", "SyntaxError"),
    "has no such object": ("OTHER = 1\n", "broken_reader", "AttributeError"),
    "is no recipe": ("RECIPE = 'mine'\n", "broken_reader", "TypeError"),
    "raises what it likes": ("raise RuntimeError('today not')\n", "broken_reader", "today not"),
    "takes a key of ours": (TAKES_OUR_KEY, "broken_reader", "taken"),
    "breaks while it looks": (BREAKS_AT_A_LOOK, "'breaks'", "PATH"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_reader_that_is_none_or_breaks_is_named_and_stops_nobody(site: Path, bare: Path, name: str) -> None:
    module, *words = BROKEN[name]
    install(site, "broken_reader", module)
    assert read(bare).source.recipe == "bluehill-csv"
    (fault,) = reader_faults()
    for word in words:
        assert word.replace("PATH", str(bare)) in fault


@pytest.mark.parametrize(
    "body",
    [
        "raise ZeroDivisionError('oh')",
        "yield 'no table'",
        "yield Table(np.array([0.0, 1.0]), np.array([0.0]), np.array([1.0, 2.0]), NAMES)",
        "yield Table(np.array([1.0, 0.0]), np.zeros(2), np.zeros(2), NAMES)",
        "yield Table(np.array([0.0, 1.0]), np.zeros(2), np.zeros(2), {'time': 't'})",
    ],
)
def test_a_reader_that_breaks_while_it_reads_is_a_refusal_of_that_file(site, bare, tmp_path, body) -> None:
    module = (
        "import numpy as np\nfrom tissueid.ingest import Recipe, Table\n"
        "NAMES = dict.fromkeys(('time', 'displacement', 'force'), 'a')\n"
        "def detect(file):\n"
        "    return (1.0, 'mine') if file.path.endswith('mine.csv') else (0.0, 'not mine')\n"
        f"def read(file):\n    {body}\n    yield from ()\n"
        "RECIPE = Recipe('breaks', 'x', detect, read)\n"
    )
    install(site, "breaking", module)
    error = refusal(put(tmp_path / "mine.csv", BARE))
    assert error.code == "reader_failed"
    assert "'breaks'" in error.message
    assert "--recipe" in error.message
    read(bare)
