"""``study.toml`` -> :class:`tissueid.manifest.Study`: parsed, its keys and units checked, its files found.

What is wrong is refused with the file, the line, the key, its value and the way out; a file or sheet that is
named and not there is not fatal, and is returned as a refusal beside the study.
"""

from __future__ import annotations

import datetime as dt
import glob
import hashlib
import json
import os
import re
import tomllib
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from tissueid.errors import InputError, UsageError, refuse
from tissueid.ingest import stated
from tissueid.ingest.options import ReadOptions
from tissueid.manifest import Calibration, Entry, FrameCurve, Study, TomlTable
from tissueid.model.frame import linear_frame
from tissueid.priors import Priors
from tissueid.result import Refusal
from tissueid.store.schema import first_problem, load_schema


def read_frame(path: str | Path) -> FrameCurve:
    """Read a frame file."""
    file = Path(path)

    def refuse(why: object) -> NoReturn:
        message = f"{why}; write it again with `tissueid calibrate-frame`"
        raise InputError(code="invalid_frame", message=message, path=str(file))

    try:
        content = file.read_bytes()
        document = json.loads(content)
    except (OSError, ValueError) as error:
        refuse(f"this is not a frame file ({error})")
    problem = first_problem(document, "frame")
    if problem is not None:
        refuse(problem)
    force = np.array(document["force_N"])
    compliance = np.array(document["compliance_mm_per_N"])
    knots = force.size
    square = all(len(row) == knots for row in document["covariance"]) and len(document["covariance"]) == knots
    if compliance.size != knots or not square or force[0] != 0.0 or (np.diff(force) <= 0.0).any():
        refuse("its knots do not belong together (forces grow from 0, one compliance each)")
    low, high = document["range_N"]
    return FrameCurve(
        force,
        compliance,
        np.array(document["covariance"]),
        range_N=(float(low), float(high)),
        path=str(file),
        sha256=hashlib.sha256(content).hexdigest(),
        sources=tuple(source["sha256"] for source in document["sources"]),
    )


# On which line of the text each table and key stands: the parser gives values without places.  The text has
# been parsed by then, so that only its shape is followed: headers, keys, and values over several lines.
#: Keys and positions in arrays, from the root.
TomlPath = tuple[str | int, ...]

_PART = r"(?:[A-Za-z0-9_-]+|\"(?:[^\"\\]|\\.)*\"|'[^']*')"
#: A header or a key, where strings are hidden.
_HEADER = re.compile(r"\s*(\[\[?)([^\[\]=]+)\]\]?\s*$")
_KEY = re.compile(r"([^\[\]{}=,]+)=")
#: Strings and comments, in which brackets and equals signs are none.
_HIDDEN = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'|#[^\n]*', re.DOTALL
)


def _parts(dotted: str) -> list[str]:
    """Parts of a dotted key, unquoted."""
    parts = [found[0] for found in re.finditer(_PART, dotted)]
    return [tomllib.loads(f"x = {part}")["x"] if part[0] in "\"'" else part for part in parts]


def _resolved(parts: list[str], counts: dict[TomlPath, int]) -> TomlPath:
    """A header's path with the position of the latest entry after every array of tables."""
    path: TomlPath = ()
    for part in parts:
        path = (*path, part)
        if path in counts:
            path = (*path, counts[path])
    return path


def _blank(found: re.Match[str]) -> str:
    """As many characters that mean nothing, on as many lines."""
    return re.sub(r"[^\n]", " " if found[0].startswith("#") else "_", found[0])


def _places(text: str) -> Iterator[tuple[TomlPath, int]]:
    counts: dict[TomlPath, int] = {}
    table: TomlPath = ()
    depth = 0
    shapes = _HIDDEN.sub(_blank, text).split("\n")
    for number, (line, shape) in enumerate(zip(text.split("\n"), shapes, strict=True), start=1):
        if depth == 0 and (header := _HEADER.match(shape)):
            parts = _parts(line[slice(*header.span(2))])
            if header[1] == "[[":
                array = (*_resolved(parts[:-1], counts), parts[-1])
                counts[array] = counts.get(array, -1) + 1
            table = _resolved(parts, counts)
            yield table, number
            continue
        if depth == 0 and (key := _KEY.match(shape)):
            yield (*table, *_parts(line[: key.end(1)])), number
        depth += sum(map(shape.count, "[{")) - sum(map(shape.count, "]}"))


def lines_of_toml(text: str) -> dict[TomlPath, int]:
    r"""Line, from 1, of every table and key of a valid TOML text.

    >>> lines_of_toml("[a]\nx = 1\n[[b]]\ny = 2\n[[b]]\n")
    {('a',): 1, ('a', 'x'): 2, ('b', 0): 3, ('b', 0, 'y'): 4, ('b', 1): 5}
    """
    lines: dict[TomlPath, int] = {}
    for path, line in _places(text):
        lines.setdefault(path, line)
    return lines


def line_of(lines: dict[TomlPath, int], path: TomlPath) -> int | None:
    """The line of a path, or of the nearest table around it."""
    around = (path[:end] for end in range(len(path), 0, -1))
    return next((lines[one] for one in around if one in lines), None)


#: Name of the manifest in the folder of its recordings.
MANIFEST = "study.toml"
SCHEMA = "tissueid/study/1"
#: Standard deviation of a stated frame stiffness whose own was not stated, as a share.
UNSTATED_FRAME_SD = 0.10
_SYNTAX_PLACE = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")
#: Keys of ``[[override]]`` that decide how a file is read.
READING = ("columns", "units", "axes")
#: What the validator says -> plain words; the first pattern that fits.
_PLAIN = (
    (re.compile(r"^'(\w+)' is a required property$"), r"\1 is missing"),
    (re.compile(r"^'(\w+)' is a dependency of '(\w+)'$"), r"\2 needs \1 beside it"),
    (re.compile(r"^'' should be non-empty$"), "it is empty"),
    *(
        (re.compile(rf"^(.*) is not of type '{kind}'$", re.DOTALL), rf"\1 must be {words}")
        for kind, words in (
            ("string", "text in quotes"),
            ("number", "a number"),
            ("integer", "a whole number"),
            ("boolean", "true or false, without quotes"),
            ("array", "a list; a table is written [[name]]"),
            ("object", "a table"),
        )
    ),
)


def _refusal(path: str, message: str, line: int | None, column: int | None = None) -> InputError:
    return InputError(code="invalid_study", message=message, path=path, line=line, column=column)


class _Refuser:
    """Refuses a part of one manifest, with its line."""

    def __init__(self, path: str, lines: dict[TomlPath, int]) -> None:
        self.path = path
        self.lines = lines

    def refuse(self, where: TomlPath, message: str) -> NoReturn:
        """Raise the refusal of the value at ``where``."""
        raise _refusal(self.path, message, line_of(self.lines, where))

    def line(self, where: TomlPath) -> int:
        """Line of a table."""
        return line_of(self.lines, where) or 1


def read_study(path: str | Path) -> Study:
    """Read a study manifest.

    Parameters
    ----------
    path : str or Path
        The file, or the folder that holds ``study.toml``.

    Returns
    -------
    Study
        Values in mm, N and s as their keys say; globs are expanded against the folder of the file.

    Raises
    ------
    InputError
        ``invalid_study`` with line; ``invalid_frame`` of the frame file it names.
    UsageError
        There is no such file.
    """
    file = Path(path)
    file = file / MANIFEST if file.is_dir() else file
    try:
        content = file.read_bytes()
    except OSError as error:
        refuse(f"{file}: can't be read ({error.strerror}); `tissueid study init` writes one")
    return study_of(content, file)


def study_of(content: bytes, file: Path) -> Study:
    """The study that a file would be with this content; refusals are those of :func:`read_study`."""
    table, refuser = _parsed(content, str(file))
    document = _normalised(table, refuser)
    _check_schema(document, refuser)
    _check_names(document, refuser)
    _check_reading(document, refuser)
    folder = file.parent
    study = Study(
        path=str(file),
        sha256=hashlib.sha256(content).hexdigest(),
        about=document.get("study", {}),
        tip=document.get("tip", {}),
        calibration=_calibration(document.get("calibration", {}), folder, refuser),
        priors=_priors(document.get("priors", {}), refuser),
        model=_model(document["model"], refuser) if "model" in document else None,
        population=stated.population_of(document["population"]) if "population" in document else None,
        specimens={entry["name"]: entry for entry in document.get("specimen", ())},
        protocols={entry["name"]: entry for entry in document.get("protocol", ())},
        trials=_entries(document, "trial", folder, refuser),
        overrides=_entries(document, "override", folder, refuser),
        exclusions=_entries(document, "exclude", folder, refuser),
    )
    _check_windows(study)
    return study


def _model(table: TomlTable, refuser: _Refuser) -> str:
    """The contact model, or those to choose among, as ``fit --model`` takes them."""
    # loaded here: the laws bring a compiler, and a look at a file needs none
    from tissueid.model.grammar import ModelNameError, candidates

    if ("name" in table) == ("candidates" in table):
        refuser.refuse(("model",), '[model] takes name = "..." or candidates = ["...", "..."], one of them')
    said = table["name"] if "name" in table else " | ".join(table["candidates"])
    try:
        candidates(said)
    except ModelNameError as error:
        refuser.refuse(("model", "name" if "name" in table else "candidates"), str(error))
    return str(said)


def _check_windows(study: Study) -> None:
    """A window starts before it ends, also where two tables state one end each."""
    for entry in study.overrides:
        for name in entry.files:
            said = study.decision(name, entry.sheet).override
            end = said.get("end_s")
            for key in ("start_s", "hold_from_s"):
                start = said.get(key)
                if start is not None and end is not None and not start < end:
                    message = f"{entry.values['file']}: {key} = {start:g} is not before end_s = {end:g}"
                    raise _refusal(study.path, message, entry.line)


def unmatched_files(study: Study) -> list[Refusal]:
    """A refusal for every table of the study that names no recording that exists."""
    words = 'file = "{}" names no file: correct the name, or take the table out'
    return [
        Refusal(study.path, None, "study_unmatched", words.format(entry.values["file"]), entry.line)
        for entry in study.entries
        if not entry.files
    ]


def _parsed(content: bytes, path: str) -> tuple[dict[str, Any], _Refuser]:
    try:
        text = content.decode("utf-8-sig")
        return tomllib.loads(text), _Refuser(path, lines_of_toml(text.replace("\r\n", "\n")))
    except UnicodeDecodeError as error:
        first = content.count(b"\n", 0, error.start) + 1
        raise _refusal(path, "the file is not UTF-8: save it as UTF-8", first) from error
    except tomllib.TOMLDecodeError as error:
        place = _SYNTAX_PLACE.search(str(error))
        line, column = (int(place[1]), int(place[2])) if place and place[1] else (None, None)
        said = _SYNTAX_PLACE.sub("", str(error))
        shown = "" if line is None else f": {text.splitlines()[line - 1].strip()[:60]!r}"
        message = f"this is not TOML ({said}){shown}; text stands in quotes, a table name in [brackets]"
        raise _refusal(path, message, line, column) from error


def _properties(*where: str | int) -> TomlTable:
    """Keys that a table of the manifest may hold, from the schema; empty where it says nothing."""
    schema = load_schema("study")

    def referred(node: TomlTable) -> TomlTable:
        found: TomlTable = node
        if "$ref" in node:
            found = schema["$defs"][node["$ref"].rpartition("/")[2]]
        return found

    node: TomlTable = schema
    for part in where:
        node = node.get("items", {}) if isinstance(part, int) else node.get("properties", {}).get(part, {})
        node = referred(node)
    found: TomlTable = referred(node.get("items", node)).get("properties", {})
    return found


def _normalised(table: TomlTable, refuser: _Refuser) -> dict[str, Any]:
    """The same document with one key for one quantity, numbers in the key's unit, dates as text."""
    top: TomlTable = load_schema("study")["properties"]
    document: dict[str, Any] = {}
    for name, value in table.items():
        if name not in top:
            near = get_close_matches(name, top, n=1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(top)}"
            refuser.refuse((name,), f"there is no table {name!r}; {hint}")
        if name == "priors" and isinstance(value, dict):
            try:
                document[name] = stated.plain_priors(value, _known_priors(value))
            except stated.PriorError as problem:
                refuser.refuse(("priors", *problem.where), str(problem))
        elif isinstance(value, dict):
            document[name] = _table(value, (name,), refuser)
        elif isinstance(value, list):
            document[name] = [
                _table(one, (name, i), refuser) if isinstance(one, dict) else one
                for i, one in enumerate(value)
            ]
        else:
            document[name] = value
    return document


def _known_priors(table: TomlTable) -> TomlTable:
    """Names of priors: those of the schema, and where one is not among them those of every law."""
    known = _properties("priors")
    if all(name in known for name in table):
        return known
    # loaded here: the laws bring a compiler, and a look at a file needs none
    from tissueid.model.grammar import stated_names

    return {**stated_names(), **known}


def _priors(plain: TomlTable, refuser: _Refuser) -> Priors:
    try:
        return stated.priors_of(plain)
    except stated.PriorError as problem:
        where: TomlPath = ("priors", *problem.where)
        refuser.refuse(where, f"{_place(where)}: {problem}")


def _table(table: TomlTable, where: TomlPath, refuser: _Refuser) -> dict[str, Any]:
    known = _properties(*where)
    plain: dict[str, Any] = {}
    for written, raw in table.items():
        value = raw.isoformat() if isinstance(raw, dt.date | dt.time) else raw
        try:
            key = stated.canonical_key(written, value, known)
            number = known[key].get("type") == "number" and stated.unit_of(key) is not None
            value = stated.in_unit(key, value) if number and isinstance(value, str) else value
        except ValueError as error:
            refuser.refuse((*where, written), str(error))
        if key in plain:
            refuser.refuse((*where, written), f"{key} is given twice: take one out")
        plain[key] = value
        if written != key:
            refuser.lines.setdefault((*where, key), refuser.line((*where, written)))
    return plain


def _check_schema(document: TomlTable, refuser: _Refuser) -> None:
    problem = first_problem(document, "study")
    if problem is None:
        return
    where: TomlPath = tuple(int(p) if p.isdecimal() else p for p in problem.pointer.split("/")[1:])
    if not where and "schema" not in document:
        refuser.refuse((), f'the first line must be: schema = "{SCHEMA}"')
    message = problem.message
    said = next((form.sub(words, message) for form, words in _PLAIN if form.match(message)), message)
    missing = said.endswith(" is missing")
    key = said.removesuffix(" is missing") if missing else str(where[-1]) if where else ""
    meaning = _properties(*(where if missing else where[:-1])).get(key, {}).get("description")
    hint = f". {key}: {meaning}" if meaning else ""
    if not where or where[-1] == "calibration":
        hint = ". frame and frame_stiffness_N_per_mm exclude each other; an _sd needs its value beside it"
    refuser.refuse(where, f"{_place(where)}: {said}{hint}")


def _place(where: TomlPath) -> str:
    """``("override", 0, "units")`` as ``[[override]] 1, units``."""
    if not where:
        return "the file"
    name, *rest = where
    if name == "priors" and rest:
        # its tables are named by a dotted header
        table, *rest = rest
        name = f"{name}.{table}"
        if not rest:
            return f"[{name}]"
    if rest and isinstance(rest[0], int):
        return ", ".join([f"[[{name}]] {rest[0] + 1}", *(str(part) for part in rest[1:])])
    return " ".join([f"[{name}]", *(str(part) for part in rest)]) if rest else str(name)


def _check_names(document: TomlTable, refuser: _Refuser) -> None:
    """Names are unique, and what is referred to exists."""
    for table in ("specimen", "protocol"):
        names: dict[str, int] = {}
        for i, entry in enumerate(document.get(table, ())):
            if entry["name"] in names:
                message = f'name = "{entry["name"]}" stands twice, here and in line {names[entry["name"]]}'
                refuser.refuse((table, i, "name"), message)
            names[entry["name"]] = refuser.line((table, i, "name"))
        for i, trial in enumerate(document.get("trial", ())):
            said = trial.get(table)
            if said is None or said in names or (table == "specimen" and not names):
                continue
            near = get_close_matches(said, names, n=1)
            hint = f'did you mean "{near[0]}"?' if near else f'add [[{table}]] with name = "{said}"'
            refuser.refuse(("trial", i, table), f'{table} = "{said}" has no [[{table}]]; {hint}')


def _check_reading(document: TomlTable, refuser: _Refuser) -> None:
    """Columns, units and axes make sense to the readers."""
    for i, entry in enumerate(document.get("override", ())):
        for key in READING:
            try:
                ReadOptions(**{key: entry.get(key, {})})
            except UsageError as error:
                refuser.refuse(("override", i, key), error.message)


def _calibration(table: TomlTable, folder: Path, refuser: _Refuser) -> Calibration:
    frame: FrameCurve | None = None
    stiffness = table.get("frame_stiffness_N_per_mm")
    values = {key: value for key, value in table.items() if key != "frame"}
    if stiffness is not None:
        values.setdefault("frame_stiffness_N_per_mm_sd", UNSTATED_FRAME_SD * stiffness)
        frame = linear_frame(stiffness, values["frame_stiffness_N_per_mm_sd"])
    elif "frame" in table:
        file = folder / table["frame"]
        if not file.is_file():
            message = f'frame = "{table["frame"]}" is not there: `tissueid calibrate-frame` writes one'
            refuser.refuse(("calibration", "frame"), message)
        frame = read_frame(file)
    return Calibration(values, frame)


def _entries(document: TomlTable, table: str, folder: Path, refuser: _Refuser) -> tuple[Entry, ...]:
    listed: Sequence[TomlTable] = document.get(table, ())
    return tuple(
        Entry(entry, tuple(_files(entry["file"], folder)), refuser.line((table, i)))
        for i, entry in enumerate(listed)
    )


def _files(pattern: str, folder: Path) -> Iterator[str]:
    """Absolute paths of the files that a name or glob means; a name that exists is never taken for a glob."""
    # globs and names are written with / on every system; a backslash is a slip of a Windows path
    for written in (pattern, pattern.replace("\\", "/")):
        if (folder / written).is_file():
            yield os.path.realpath(folder / written)
            return
    whole = os.path.join(glob.escape(str(folder)), pattern.replace("\\", "/"))  # noqa: PTH118 -- glob takes text
    for name in sorted(glob.glob(whole, recursive=True)):  # noqa: PTH207 -- Path.glob refuses absolute patterns
        if Path(name).is_file():
            yield os.path.realpath(name)
