"""A small folder of recordings with a study file, and the quickest fit of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tissueid.cli.main import main

#: One branch, constant K and no posterior: the quickest fit.
QUICK = ("--branches", "1", "--stiffness-degree", "0", "--sampler", "none")
#: As quick as a fit with posteriors can be.
SAMPLED = ("--branches", "1", "--stiffness-degree", "0", "--draws", "400")
#: First line of a study file.
HEAD = 'schema = "tissueid/study/1"\n'
REPOSITORY = Path(__file__).resolve().parents[2]
LOG = REPOSITORY / "datasets_synthetic" / "paper-a-hold-100Hz" / "hold-8-1.csv"
HEADER_LINES = 6
#: Rows of the 100 Hz ramp and hold, and every how many-th of them: 400 rows, 16 s.
ROWS, STRIDE = 1600, 4


def recording(
    *, times: float = 1.0, header: str = "", names: str = "Time,Extension,Load", stride: int = STRIDE
) -> str:
    """A ramp and hold with its force ``times`` as large."""
    lines = LOG.read_text(encoding="ascii").splitlines()
    cells = [line.split(",") for line in lines[HEADER_LINES : HEADER_LINES + ROWS : stride]]
    rows = [f"{t},{x},{float(f) * times:.4f}" for t, x, f in cells]
    return "\n".join([*([header, ""] if header else []), names, "(sec),(mm),(N)", *rows, ""])


def manifest_in(folder: Path, text: str) -> Path:
    """The study file of a folder."""
    path = folder / "study.toml"
    path.write_text(HEAD + text, encoding="utf-8")
    return path


def lab(folder: Path, manifest: str, **times: float) -> Path:
    """A folder with ``<name>.csv`` for each name, force ``times`` as large, and its study file."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, factor in times.items():
        (folder / f"{name}.csv").write_text(recording(times=factor), encoding="ascii")
    manifest_in(folder, manifest)
    return folder


def fit(*args: str | Path, out: Path) -> tuple[int, dict[str, Any]]:
    """Exit code and identification.json of ``tissueid fit ARGS``; empty where nothing was fitted."""
    # what a test asks for comes last and wins
    code = main(["fit", *QUICK, *map(str, args), "-o", str(out), "-q"])
    path = out / "identification.json"
    return code, json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def fit_lab(
    folder: Path, manifest: str, *args: str, out: str = "out", **times: float
) -> tuple[int, dict[str, Any]]:
    """Exit code and identification.json of the fit of :func:`lab` in ``folder/lab``."""
    return fit(lab(folder / "lab", manifest, **times), *args, out=folder / out)


def specimen(document: dict[str, Any], name: str) -> dict[str, Any]:
    (found,) = [entry for entry in document["specimens"] if entry["specimen"] == name]
    return found


def value(document: dict[str, Any], name: str, parameter: str) -> float:
    (found,) = [entry for entry in specimen(document, name)["parameters"] if entry["name"] == parameter]
    return float(found["value"])
