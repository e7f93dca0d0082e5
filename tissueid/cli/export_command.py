"""``tissueid export``."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tissueid.cli.flags import PATH, THERE, OutputFlags, argument, option, subcommand
from tissueid.cli.output import echo_bytes, echo_json, write_output
from tissueid.errors import printable, refuse

if TYPE_CHECKING:
    from tissueid.store.bundle import Bundle
    from tissueid.store.posteriors import StoredPosterior

#: The tables of :data:`tissueid.store.tidy.TABLES`, named here so that --help loads nothing.
TABLES = ("specimens", "trials", "cycles", "quantities")
#: What is made of one tissue.
TISSUES = ("c-header", "febio", "abaqus")
#: Specimens that a message names.
LISTED = 6


class _ExportFlags(OutputFlags):
    out: str = argument(type=THERE)
    form: str = option(
        "The document; a CSV table with one row a specimen, a trial, a load-unload loop, a quoted number; "
        "the posterior's draws for arviz, one file a specimen; all specimens for MATLAB; or one tissue as a "
        "C header with its step, or as a Prony series for FEBio or Abaqus.",
        "--format",
        type=click.Choice(["json", *TABLES, "netcdf", "mat", *TISSUES]),
        default="json",
    )
    specimen: str | None = option("Which one, where a single tissue is written.", metavar="NAME")
    depth: float | None = option(
        "A Prony series holds about this depth. [default: half of the claimed depth]", metavar="MM"
    )
    output: str | None = option("File to write instead of stdout.", "-o", type=PATH)


@subcommand(
    "export",
    "out",
    "out --format specimens -o specimens.csv",
    "out --format trials -o trials.csv",
    "out --format json -o result.json",
    "out --format netcdf -o chains.nc",
    "out --format mat -o tissues.mat",
    "out/bundle.h5 --format c-header -o tissue.h",
    "out --format abaqus --specimen kidney-3 --depth 4",
)
def command(flags: _ExportFlags) -> int:
    """Write a finished fit in another form, from its output folder alone.

    OUT is the folder; for mat, c-header, febio and abaqus a bundle will do.

    The tables read straight into R (read.csv) and Prism: UTF-8, comma, decimal point, units in the column
    names, an empty cell where nothing is known.  NetCDF needs arviz (pip install 'tissueid[arviz]'); where a
    fit has several specimens, each gets a file: chains-SPECIMEN.nc.
    """
    from tissueid.store.files import json_bytes
    from tissueid.store.results import read_plain, read_results
    from tissueid.store.tidy import csv_bytes, tidy_table

    of_tissues = flags.form in ("mat", *TISSUES)
    if flags.specimen is not None and not of_tissues:
        refuse(f"--specimen chooses among tissues, and {flags.form} holds all of them; leave it out")
    if flags.depth is not None and flags.form not in TISSUES[1:]:
        refuse(f"--depth is that of a Prony series, as --format abaqus; leave it out of {flags.form}")
    if of_tissues:
        return _write_tissues(flags)
    if Path(flags.out).is_file():
        refuse(f"{flags.out} is one file: {flags.form} is made from the whole output folder")
    document, _, posteriors = read_results(flags.out)
    if flags.form == "netcdf":
        return _write_netcdf(posteriors, flags)
    as_json = flags.form == "json"
    if as_json and flags.output is None:
        echo_json(read_plain(flags.out))
        return 0
    whole = json_bytes(read_plain(flags.out))
    # the bytes of identification.json have one spelling, so this is the hash of the file
    digest = hashlib.sha256(whole).hexdigest()
    _write(whole if as_json else csv_bytes(tidy_table(document, flags.form, digest=digest)), flags)
    return 0


def _write(content: bytes, flags: _ExportFlags) -> None:
    if flags.output is None:
        echo_bytes(content)
    else:
        write_output(flags.output, content, quiet=flags.quiet)


def _write_tissues(flags: _ExportFlags) -> int:
    from tissueid.export.c_header import c_header
    from tissueid.export.matlab import mat_bytes
    from tissueid.export.prony import FEBIO_TERMS, abaqus_card, febio_card, linearised

    bundles = _bundles(flags)
    if flags.form == "mat":
        if flags.output is None:
            refuse("a MATLAB file is no text for a terminal: name a file with -o, as -o tissues.mat")
        content = mat_bytes(bundles)
    elif len(bundles) > 1:
        names = ", ".join(repr(bundle.specimen) for bundle in bundles[:LISTED])
        more = " ..." if len(bundles) > LISTED else ""
        refuse(f"{flags.out} holds {len(bundles)} specimens: choose one with --specimen {names}{more}")
    elif flags.form == "c-header":
        content = c_header(bundles[0])
    elif flags.form == "febio":
        content = febio_card(linearised(bundles[0], flags.depth, most=FEBIO_TERMS))
    else:
        content = abaqus_card(linearised(bundles[0], flags.depth))
    _write(content, flags)
    return 0


def _bundles(flags: _ExportFlags) -> list[Bundle]:
    """The bundle that was named, or those of a folder."""
    from tissueid.store.bundle import load_bundle
    from tissueid.store.files import bundle_names
    from tissueid.store.results import read_results

    path, wanted = Path(flags.out), flags.specimen
    if path.is_file():
        files = {load_bundle(path).specimen: path}
    else:
        names = bundle_names(one.specimen for one in read_results(str(path))[0].specimens)
        files = {name: path / file for name, file in names.items()}
    if wanted is not None and wanted not in files:
        refuse(f"--specimen {printable(wanted)}: {path} holds {', '.join(list(files)[:LISTED])}")
    return [load_bundle(file) for name, file in files.items() if wanted in (None, name)]


def _write_netcdf(posteriors: Sequence[StoredPosterior], flags: _ExportFlags) -> int:
    from tissueid.store.files import file_names
    from tissueid.uncertainty import netcdf_bytes

    if flags.output is None:
        refuse("netcdf is no text for a terminal: name a file with -o, as -o chains.nc")
    if not posteriors:
        refuse(f"{flags.out}: no posterior was sampled; run `tissueid fit` again without --sampler none")
    first = Path(flags.output)
    names = file_names((one.specimen for one in posteriors), first.stem, first.suffix)
    for one in posteriors:
        path = first if len(posteriors) == 1 else first.with_name(names[one.specimen])
        write_output(path, netcdf_bytes(one.to_arviz()), quiet=flags.quiet)
    return 0
