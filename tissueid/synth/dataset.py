"""A synthetic set on disk: one export a log, recipe.toml, truth.json and SHA256SUMS; same seed, same bytes.

Exports are written from the grammar of each format, with no part of the reader; each says that it is
synthetic.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np

from tissueid.errors import refuse
from tissueid.store.files import write_file
from tissueid.synth.bluehill import DIALECTS, bluehill_csv
from tissueid.synth.machines import (
    Decimals,
    bluehill_workbook,
    chiaro_text,
    chiaro_zip,
    mach1_text,
    mts793_text,
    shimadzu_text,
    tra_text,
    zwick_workbook,
)
from tissueid.synth.recipe import Recipe, dump_recipe
from tissueid.synth.simulate import SyntheticLog, simulate


@dataclass(frozen=True, slots=True)
class Export:
    """A way to write a log."""

    description: str  # one line for the help
    suffix: str  # of the file, with its point
    write: Callable[..., bytes]  # ``write(log, decimals=...) -> bytes``


def _one(write: Callable[..., bytes], **how: object) -> Callable[..., bytes]:
    """A writer of several logs, given one."""

    def written(log: SyntheticLog, *, decimals: Decimals = (5, 5, 5)) -> bytes:
        return write([log], decimals=decimals, **how)

    return written


#: Exports by name.
EXPORTS: Mapping[str, Export] = MappingProxyType(
    {
        **{
            name: Export(f"Bluehill: {dialect.description}", ".csv", partial(bluehill_csv, dialect=dialect))
            for name, dialect in DIALECTS.items()
        },
        "bluehill-workbook": Export(
            "Bluehill's table as .xlsx, with half-cycle counters", ".xlsx", _one(bluehill_workbook)
        ),
        "testxpert-tra": Export("testXpert .TRA, English", ".TRA", partial(tra_text, language="en")),
        "testxpert-tra-fr": Export("testXpert .TRA, French", ".TRA", partial(tra_text, language="fr")),
        "testxpert-tra-de": Export(
            "testXpert .TRA, German, semicolons and decimal commas",
            ".TRA",
            partial(tra_text, language="de", delimiter=";", decimal=","),
        ),
        **{
            name: Export(f"testXpert .xlsx, {spoken}", ".xlsx", _one(zwick_workbook, language=language))
            for name, spoken, language in (
                ("testxpert-workbook", "English", "en"),
                ("testxpert-workbook-fr", "French", "fr"),
                ("testxpert-workbook-de", "German", "de"),
            )
        },
        "mach-1": Export("Mach-1 text: a contact block, then the log, in gf", ".txt", _one(mach1_text)),
        "mts-793": Export("MTS 793 text, English", ".dat", _one(mts793_text, language="en")),
        "mts-793-de": Export(
            "MTS 793 text, German, decimal commas, kN", ".dat", _one(mts793_text, language="de")
        ),
        "shimadzu": Export("Shimadzu text: three head rows", ".csv", _one(shimadzu_text)),
        "chiaro": Export("Optics11 Chiaro text, in uN and nm", ".txt", chiaro_text),
        "chiaro-zip": Export("Optics11 Chiaro text in a zip archive", ".zip", chiaro_zip),
    }
)


#: Digits of a number in truth.json: more than any test can see, fewer than differ between machines.
TRUTH_DIGITS = 12


def write_set(recipe: Recipe, directory: str | Path, *, seed: int, dialect: str = "bare") -> list[Path]:
    """Simulate a recipe and write the set."""
    if dialect not in EXPORTS:
        refuse(f"no dialect {dialect!r}; there are {', '.join(sorted(EXPORTS))}")
    logs = simulate(recipe, rng=np.random.default_rng(seed))
    export = EXPORTS[dialect]
    contents = {f"{log.name}{export.suffix}": export.write(log, decimals=recipe.decimals) for log in logs}
    contents["recipe.toml"] = dump_recipe(recipe).encode()
    contents["truth.json"] = _truth(recipe, logs, seed=seed, dialect=dialect, suffix=export.suffix)
    sums = [f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in sorted(contents.items())]
    contents["SHA256SUMS"] = "".join(sums).encode()

    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    foreign = sorted(entry.name for entry in directory.iterdir() if entry.name not in contents)
    if foreign:
        refuse(f"{directory} already holds {foreign[0]!r}, not part of this set; give an empty directory")
    for name, data in contents.items():
        write_file(directory / name, data)
    return [directory / name for name in contents]


def _truth(recipe: Recipe, logs: list[SyntheticLog], *, seed: int, dialect: str, suffix: str) -> bytes:
    """truth.json: the law, and what was drawn for each log."""
    document = {
        "synthetic": True,
        "recipe": recipe.name,
        "seed": seed,
        "dialect": dialect,
        "static_N_per_mm_powers": recipe.static,
        "branches": [asdict(branch) for branch in recipe.branches],
        "sigma_N": recipe.sigma_N,
        "n_samples": sum(log.time_s.size for log in logs),
        "logs": [
            {
                "file": f"{log.name}{suffix}",
                "specimen": log.specimen,
                "n_samples": log.time_s.size,
                **log.truth,
            }
            for log in logs
        ],
    }
    rounded = json.loads(
        json.dumps(document), parse_float=lambda text: float(f"{float(text):.{TRUTH_DIGITS}g}")
    )
    return (json.dumps(rounded, indent=1, allow_nan=False) + "\n").encode()
