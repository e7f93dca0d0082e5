"""The JSON Schemas: where they are found, and the checks that documents go through.

They live in ``schemas/`` of the repository and travel in the wheel as ``tissueid/schemas``; an editable
install has no copy in the package, so the checkout beside it is asked second.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module, resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from tissueid.documents.base import typed
from tissueid.errors import BundleError

if TYPE_CHECKING:
    from jsonschema.protocols import Validator

#: Mark of a document that is a list.
LIST = "*"
#: Root type of every schema, by its name, as MODULE.TYPE of :mod:`tissueid.documents`; where several are
#: given, a document is one of them, and those behind :data:`LIST` are its items.
ROOTS: Mapping[str, str] = {
    "bundle": "folder.Bundle",
    "contrast": "contrast.Contrast",
    "control": "control.Control",
    "design": "design.Design",
    "devices": "devices.List devices.Info devices.Home devices.Test devices.Force devices.Damping",
    "flag": "base.Flag",
    "frame": "folder.Frame",
    "identification": "identification.Identification",
    "inspect": "*inspect.Trial inspect.Refusal",
    "measured": "measured.Measured",
    "measured-contrast": "contrast.MeasuredContrast",
    "outputs": "folder.Outputs",
    "population": "population.Population",
    "quantities": "quantities.Quoted quantities.Cycle quantities.Unloading quantities.UnloadingMiss",
    "reproduction": "reproduction.Reproduction",
    "rupture": "rupture.Rupture",
    "scene": "scene.Scene",
    "selfcheck": "selfcheck.SelfCheck",
    "session": "session.Session",
    "status": "folder.Status",
    "study": "study.StudyFile",
    "study-check": "study.StudyCheck",
    "training": "session.Training",
    "twin": "twin.Twin",
    "watch": "inspect.Watch",
}
_LONGEST_MESSAGE = 300


@dataclass(frozen=True, slots=True)
class SchemaProblem:
    """The first thing a document gets wrong."""

    pointer: str  # JSON pointer (RFC 6901) of the offending value; empty for the document itself
    message: str  # what is wrong with it

    def __str__(self) -> str:
        return f"{self.pointer or '(document)'}: {self.message}"


def kinds_of(name: str) -> list[type[Any]]:
    """Types of which a document is one, or each element of it; ``name``: a key of :data:`ROOTS`."""
    places = [one.rpartition(".") for one in ROOTS[name].removeprefix(LIST).split()]
    return [getattr(import_module(f"tissueid.documents.{module}"), kind) for module, _, kind in places]


def schema_folder() -> Traversable:
    """Find the folder of the schemas, the package's or the checkout's; BundleError where there is neither."""
    packaged = resources.files("tissueid") / "schemas"
    checkout = Path(__file__).resolve().parents[2] / "schemas"
    for folder in (packaged, checkout):
        if (folder / "flag.schema.json").is_file():
            return folder
    msg = f"no schemas in {packaged} nor in {checkout}: the installation is damaged, install tissueid again"
    raise BundleError(msg)


@cache
def load_schema(name: str) -> Mapping[str, Any]:
    """Load one schema, by its name, as parsed JSON."""
    if name not in ROOTS:
        raise KeyError(f"there is no schema {name!r}; there are {', '.join(ROOTS)}")
    schema: dict[str, Any] = json.loads((schema_folder() / f"{name}.schema.json").read_bytes())
    return schema


@cache
def _validator(name: str) -> Validator:
    # jsonschema costs some 0.1 s to import: only commands that check something pay for it
    from jsonschema import Draft202012Validator

    return Draft202012Validator(load_schema(name))


def _pointer(path: tuple[str | int, ...]) -> str:
    return "".join("/" + str(part).replace("~", "~0").replace("/", "~1") for part in path)


def _non_finite(value: Any, path: tuple[str | int, ...] = ()) -> SchemaProblem | None:
    # JSON Schema's "number" lets NaN and infinity through, JSON itself does not
    if isinstance(value, float) and not math.isfinite(value):
        return SchemaProblem(_pointer(path), f"{value} is not a finite number")
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return next(filter(None, (_non_finite(child, (*path, key)) for key, child in items)), None)


def first_problem(document: Any, name: str) -> SchemaProblem | None:
    """Find the most telling way in which a document of plain values breaks a schema, or ``None``."""
    from jsonschema.exceptions import best_match

    error = best_match(_validator(name).iter_errors(document))
    if error is None:
        return _non_finite(document)
    cut = " ..." if len(error.message) > _LONGEST_MESSAGE else ""
    return SchemaProblem(_pointer(tuple(error.absolute_path)), error.message[:_LONGEST_MESSAGE] + cut)


def _problem_of_types(document: Any, name: str) -> SchemaProblem | None:
    """Find the first way in which a document breaks its types, which the schemas are made from."""
    kinds = kinds_of(name)
    if len(kinds) > 1 or ROOTS[name].startswith(LIST):
        return first_problem(document, name)
    try:
        typed(document, kinds[0], known=True)
    except msgspec.ValidationError as error:
        words, _, place = str(error).partition(" - at `$")
        return SchemaProblem(re.sub(r"[.\[]([^.\[\]]+)\]?", r"/\1", place.rstrip("`")), words)
    return _non_finite(document)


def check(document: Any, name: str, *, where: str = "", way_out: str = "") -> None:
    """Refuse a document that breaks its types; people's own files are held against the whole schema.

    ``where``: file or stage the document came from, for the message; ``way_out``: its end.  Raises
    BundleError: naming the JSON pointer of the first problem.
    """
    problem = _problem_of_types(document, name)
    if problem is not None:
        prefix = f"{where}: " if where else ""
        suffix = f"; {way_out}" if way_out else ""
        raise BundleError(f"{prefix}not a valid {name} document at {problem}{suffix}")
