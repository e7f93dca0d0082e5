"""JSON Schemas of the documents, made from their types and the comments beside their fields."""

from __future__ import annotations

import ast
import inspect
import io
import re
import tokenize
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

import msgspec

from tissueid.documents.base import JsonSchema
from tissueid.flags import FLAGS, Flag

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
DIALECT = "https://json-schema.org/draft/2020-12/schema"
#: Files that people write: TOML has no null, so that what is left out has no second spelling.
_WRITTEN_BY_HAND = {"scene", "study"}
_REFERENCE = "#/$defs/{name}"
_FLAG = "#/$defs/flag"
_PLAIN = {"type": ["number", "string", "boolean", "null"]}
#: JSON Schema of a flag: which numbers stand behind its sentence depends on its code.
FLAG_SCHEMA: JsonSchema = {
    "description": "A stable code, one plain sentence, and the numbers behind it as further members.",
    "type": "object",
    "properties": {
        "code": {"enum": list(FLAGS)},
        "message": {"type": "string", "minLength": 1, "description": "One plain sentence with its numbers"},
    },
    "required": ["code", "message"],
    "additionalProperties": {"anyOf": [_PLAIN, {"type": "array", "items": _PLAIN}]},
}


def kinds_of(name: str) -> list[type[Any]]:
    """Types of which a document is one, or each element of it; ``name``: a key of :data:`ROOTS`."""
    places = [one.rpartition(".") for one in ROOTS[name].removeprefix(LIST).split()]
    return [getattr(import_module(f"tissueid.documents.{module}"), kind) for module, _, kind in places]


def schema_of(name: str) -> dict[str, Any]:
    """JSON Schema (2020-12) of a document.

    ``name``: a key of :data:`ROOTS`.  Raises KeyError: for any other.
    """
    head: dict[str, Any] = {"$schema": DIALECT, "$id": f"{name}.schema.json"}
    if name == "flag":
        return {**head, "title": "One remark about a recording or a fit", **FLAG_SCHEMA}
    roots = kinds_of(name)
    outer, components = msgspec.json.schema_components(
        roots, ref_template=_REFERENCE, schema_hook=_flag_reference
    )
    definitions = {_snake(key): _rewritten(one) for key, one in components.items()}
    if any(_FLAG in repr(one) for one in definitions.values()):
        definitions["flag"] = dict(FLAG_SCHEMA)
    for kind in _kinds(roots):
        # the whole name where two records have the short one
        whole = f"{kind.__module__}.{kind.__qualname__}"
        definition = definitions[_snake(kind.__name__ if kind.__name__ in components else whole)]
        _describe(definition, kind)
        if name in _WRITTEN_BY_HAND:
            _without_null(definition)
    head["title"] = (roots[0].__doc__ or "").split("\n")[0].rstrip(".")
    references = [_rewritten(one) for one in outer]
    body: dict[str, Any] = {"oneOf": references}
    if len(roots) == 1:
        body = definitions.pop(references[0]["$ref"].rpartition("/")[2])
    if ROOTS[name].startswith(LIST):
        body = {"type": "array", "items": body}
    return {**head, **body, **({"$defs": definitions} if definitions else {})}


def _flag_reference(kind: type[Any]) -> dict[str, str]:
    if kind is Flag:
        return {"$ref": _FLAG}
    raise NotImplementedError


def _snake(name: str) -> str:
    """Key of a definition: ``StatedTrial`` is ``stated_trial``; of two types of one name both with module."""
    module, _, kind = name.replace("tissueid.documents.", "").rpartition(".")
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", kind).lower()
    return f"{module}_{words}" if module else words


def _rewritten(node: Any) -> Any:
    """The same schema, its references by the keys of this project."""
    if isinstance(node, dict):
        alike = node.get("prefixItems", ())
        if alike and all(one == alike[0] for one in alike):  # a pair, a vector
            node = {key: child for key, child in node.items() if key != "prefixItems"} | {"items": alike[0]}
        return {
            key: f"#/$defs/{_snake(child.rpartition('/')[2])}" if key == "$ref" else _rewritten(child)
            for key, child in node.items()
            if not (key == "title" and isinstance(child, str))
        }
    return [_rewritten(child) for child in node] if isinstance(node, list | tuple) else node


def _kinds(roots: list[type[msgspec.Struct]]) -> Iterator[type[msgspec.Struct]]:
    """Every record that a document may hold, each once."""
    seen: set[type[msgspec.Struct]] = set()
    waiting: list[Any] = list(msgspec.inspect.multi_type_info(roots))
    while waiting:
        node = waiting.pop()
        if isinstance(node, msgspec.inspect.StructType):
            if node.cls in seen:
                continue
            seen.add(node.cls)
            yield node.cls
            waiting += [field.type for field in node.fields]
        for key in ("type", "item_type", "value_type"):
            waiting += [child] if (child := getattr(node, key, None)) is not None else []
        for key in ("types", "item_types"):
            waiting += getattr(node, key, ())


def _describe(definition: dict[str, Any], kind: type[msgspec.Struct]) -> None:
    """Add what is said at the fields, and rules that no type can say; indents of docstrings go."""
    if "description" in definition:
        definition["description"] = inspect.cleandoc(definition["description"])
    for field in msgspec.structs.fields(kind):
        owner = next(one for one in kind.__mro__ if field.name in getattr(one, "__annotations__", {}))
        words = _comments(import_module(owner.__module__)).get((owner.__name__, field.name))
        if words:
            definition["properties"][field.encode_name]["description"] = words
    if "additionalProperties" not in definition:
        definition["additionalProperties"] = True
    definition |= getattr(kind, "RULES", {})


@cache
def _comments(module: ModuleType) -> Mapping[tuple[str, str], str]:
    """Sentence beside or above each field of the records of a module."""
    source = inspect.getsource(module)
    lines: dict[int, tuple[str, bool]] = {}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            alone = token.line.lstrip().startswith("#")
            lines[token.start[0]] = (token.string.lstrip("#: "), alone)
    found = {}
    for kind in ast.walk(ast.parse(source)):
        if not isinstance(kind, ast.ClassDef):
            continue
        for field in kind.body:
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                words = [lines[field.end_lineno or 0][0]] if (field.end_lineno or 0) in lines else []
                line = field.lineno - 1
                while line in lines and lines[line][1]:
                    words.insert(0, lines[line][0])
                    line -= 1
                found[kind.name, field.target.id] = " ".join(words)
    return found


def _without_null(definition: dict[str, Any]) -> None:
    """Keep null out of a file that people write: what is left out has no second spelling."""
    for key, node in definition.get("properties", {}).items():
        if node.pop("default", 0) is None and "anyOf" in node:
            kept = [one for one in node.pop("anyOf") if one != {"type": "null"}]
            definition["properties"][key] = {**(kept[0] if len(kept) == 1 else {"anyOf": kept}), **node}
