"""``tissueid fit --contact-law hertz-impact``: another law from the same recordings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from tissueid.cli.output import echo, echo_json, note, progress_bar
from tissueid.cli.reading import read_all, read_in_order, read_options, segment_options
from tissueid.digits import together, with_error
from tissueid.errors import UsageError, exit_code

__all__ = ["LAWS", "fit_law"]

#: The tissue's own law, and the one of a hard body.
LAWS = ("kelvin-voigt", "hertz-impact")
NAMES = ("contact-law.json", "contact-law.html")
#: Options of a tissue's fit, which mean nothing to a hard body.
OF_A_TISSUE = (
    *("branches", "stiffness_degree", "static", "noise", "sampler", "draws", "require"),
    *("workers", "scheduler", "population"),
)


def fit_law(flags: Mapping[str, Any]) -> int:
    """Identify k, n and e of every specimen; 0, 3 where all was refused, 4 not identified, 7 some refused."""
    _refuse_others()
    from tissueid.report.contact_law_page import render_contact_law
    from tissueid.result import Refusal
    from tissueid.store.files import json_bytes, write_file
    from tissueid.store.schema import check
    from tissueid.study.contact_law import contact_law_document
    from tissueid.study.recordings import locate_study, read_decided_one

    options = segment_options(flags)
    study, paths = locate_study(flags["paths"], named=flags["study"], ignore=flags["no_study"])
    refused: list[Refusal] = []
    with progress_bar(show=not flags["quiet"]) as progress:
        progress("fitting the contact law", 0, 0)
        reading = read_options(flags)
        document = contact_law_document(
            read_all(read_in_order(paths, reading, study), refused),
            options,
            refused,
            study=study,
            reload=lambda source: read_decided_one(source.path, source.sheet, reading, study),
        )
    check(document, "contact-law")
    if document["specimens"]:
        out = Path(flags["out"])
        out.mkdir(parents=True, exist_ok=True)
        page = render_contact_law(document).encode()
        for name, content in zip(NAMES, (json_bytes(document), page), strict=True):
            write_file(out / name, content)
    if flags["as_json"]:
        echo_json(document)
    elif not flags["quiet"]:
        _print(document)
    for one in document["refused"]:
        note(f"{one['path']}: {one['error']['message']}")
    return exit_code(_codes(document))


def _refuse_others() -> None:
    """Options that would have no effect are a misunderstanding, and said to be one."""
    context = click.get_current_context()
    asked = [
        f"--{name.replace('_', '-')}"
        for name in OF_A_TISSUE
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE
    ]
    if asked:
        msg = f"{', '.join(asked)}: of a tissue's fit; --contact-law hertz-impact takes no such option"
        raise UsageError(msg)


def _codes(document: Mapping[str, Any]) -> set[int]:
    specimens = document["specimens"]
    codes = {0}
    if document["refused"]:
        codes.add(7 if specimens else 3)
    if any(entry["value"] is None for one in specimens for entry in one["parameters"]):
        codes.add(4)
    return codes


def _print(document: Mapping[str, Any]) -> None:
    for one in document["specimens"]:
        echo(f"{one['specimen']}: {len(one['logs'])} recordings, NRMSD {100.0 * one['nrmsd']:.2f} %")
        for entry in one["parameters"]:
            unit = "" if entry["unit"] == "1" else f" {entry['unit']}"
            if entry["value"] is None:
                echo(f"  {entry['symbol']}  not identified: {entry['reason']}")
            else:
                low, high = together(entry["ci95"], entry["stderr"])
                told = with_error(entry["value"], entry["stderr"])
                echo(f"  {entry['symbol']}  {told}{unit} (95 %: {low} to {high})")
