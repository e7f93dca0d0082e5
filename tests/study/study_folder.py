"""A small folder of recordings with a study file, and the quickest fit of it."""

from pathlib import Path
from typing import Any

from command_line import QUICK, read_json, run, write_log, write_study

#: As quick as a fit with posteriors can be.
SAMPLED = ("--branches", "1", "--stiffness-degree", "0", "--draws", "400")


def lab(folder: Path, manifest: str, **times: float) -> Path:
    """A folder with ``<name>.csv`` for each name, force ``times`` as large, and its study file."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, factor in times.items():
        write_log(folder / f"{name}.csv", label=None, force_times=factor)
    write_study(folder, manifest)
    return folder


def fit(*args: str | Path, out: Path) -> tuple[int, dict[str, Any]]:
    """Exit code and identification.json of ``tissueid fit ARGS``; empty where nothing was fitted."""
    # what a test asks for comes last and wins
    code = run("fit", *QUICK, *args, "-o", out, "-q").code
    path = out / "identification.json"
    return code, read_json(path) if path.exists() else {}


def specimen(document: dict[str, Any], name: str) -> dict[str, Any]:
    (found,) = [entry for entry in document["specimens"] if entry["specimen"] == name]
    return found


def value(document: dict[str, Any], name: str, parameter: str) -> float:
    (found,) = [entry for entry in specimen(document, name)["parameters"] if entry["name"] == parameter]
    return float(found["value"])
