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
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_type_hints

import msgspec

from tissueid.documents.base import typed
from tissueid.errors import BundleError

if TYPE_CHECKING:
    from jsonschema.protocols import Validator

_T = TypeVar("_T")

_LONGEST_MESSAGE = 300


@dataclass(frozen=True, slots=True)
class SchemaProblem:
    """The first thing a document gets wrong."""

    pointer: str  # JSON pointer (RFC 6901) of the offending value; empty for the document itself
    message: str  # what is wrong with it

    def __str__(self) -> str:
        return f"{self.pointer or '(document)'}: {self.message}"


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


def check(document: Any, kind: type[_T], *, where: str = "", way_out: str = "") -> _T:
    """Read a document of this version as its type; people's own files are held against the whole schema.

    ``kind``: a record whose ``schema`` names it; ``where``: file or stage the document came from, for the
    message; ``way_out``: its end.  Raises BundleError: naming the JSON pointer of the first problem.
    """
    try:
        found, problem = typed(document, kind, known=True), _non_finite(document)
        if problem is None:
            return found
    except msgspec.ValidationError as error:
        words, _, place = str(error).partition(" - at `$")
        problem = SchemaProblem(re.sub(r"[.\[]([^.\[\]]+)\]?", r"/\1", place.rstrip("`")), words)
    (schema,) = get_args(get_type_hints(kind)["schema"])
    prefix, suffix = f"{where}: " if where else "", f"; {way_out}" if way_out else ""
    raise BundleError(f"{prefix}not a valid {schema.split('/')[1]} document at {problem}{suffix}")
