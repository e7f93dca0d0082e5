"""``tissueid design``."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from tissueid.cli.flags import FOLDER, FROM_1, PATH, OutputFlags, argument, option, subcommand
from tissueid.cli.output import (
    checked,
    echo,
    echo_json,
    echo_table,
    made_folder,
    note,
    progress_bar,
    refuse_foreign,
)
from tissueid.documents.design import Design, Protocol
from tissueid.errors import NotIdentifiedError, refuse
from tissueid.report.wording import time_words
from tissueid.store.files import json_bytes, time_now, write_file

if TYPE_CHECKING:
    from tissueid.design.machine import Machine
    from tissueid.design.plan import Against, Plan
    from tissueid.design.precision import Asked
    from tissueid.design.tissues import Tissues
    from tissueid.synth import Recipe

_FILES = ("design.json", "design.html", "study.toml", "test-sheet.csv", "recipe.toml")
_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}
#: Precision that is wanted where nothing is said.
DEFAULT_WANT = "5%"


class _DesignFlags(OutputFlags):
    # fmt: off
    source: str | None = argument(required=False, type=PATH)
    guesses: tuple[str, ...] = option(
        "A guess of the tissue instead of SOURCE, with its spread (one standard deviation); repeat it.",
        "--tissue", metavar="NAME=VALUE[~PERCENT%]",
    )
    machine: str | None = option(
        "machine.toml, or a preset; without it the presets are named.", metavar="FILE|NAME"
    )
    wants: tuple[str, ...] = option(
        "Standard deviation that an estimate shall have at the most; repeat it. Default: what --against "
        "reaches, or 5 % of every relaxation time and viscosity.",
        "--want", metavar="NAME=PERCENT%",
    )
    against: str | None = option(
        "A protocol to compare with; a recipe as SOURCE is compared with.", metavar="RECIPE"
    )
    max_depth: float | None = option("Depth that the tissue bears; default what is known.", metavar="MM")
    max_force: float | None = option("Force that the tissue bears; default the load cell's.", metavar="N")
    budget: str = option("Machine time a specimen: 90min, 2h.", default="8h", metavar="TIME")
    recovery: float = option("Rest between logs.", default=60.0, metavar="S")
    setup: float = option("Changing and zeroing a specimen.", default=600.0, metavar="S")
    specimens: int = option(
        "Specimens to test: the whole time is said as well.", type=FROM_1, default=1, metavar="N"
    )
    repeats: int = option("Fewest repeats of each indentation.", type=FROM_1, default=3, metavar="N")
    max_logs: int = option("Most logs a specimen.", type=FROM_1, default=60, metavar="N")
    gain_sd: float = option(
        "Scatter of the force from log to log (standard deviation of the ln gain).",
        default=0.02, metavar="SD",
    )
    time_sd: float = option(
        "The same of the relaxation times, which a fit lets differ.", default=0.02, metavar="SD"
    )
    interval: Literal["statistical", "total"] = option(
        "total counts what is unknown of gains, skew, filter and frame.", default="statistical"
    )
    assurance: float = option(
        "Share of the tissues for which the precision must be reached.",
        type=click.FloatRange(0.5, 1.0), default=0.9, metavar="SHARE",
    )
    draws: int = option("Tissues drawn from what is known.", type=FROM_1, default=16, metavar="N")
    out: str | None = option(
        "Folder for design.json, design.html, study.toml, test-sheet.csv and recipe.toml.", "-o", type=FOLDER
    )
    # fmt: on


@subcommand(
    "design",
    "paper-a-30 --machine paper-a -o plan",
    "out/bundle.h5 --machine our_machine.toml --want relaxation_time_s=5% --want viscosity=2%",
    "--tissue tau=0.02~30% --tissue eta=1.3 --tissue static_1_N_per_mm=20 --max-depth 6 --machine bench",
    "out/bundle.h5 --machine bench --against paper-a-22 --interval total --budget 2h",
)
def command(flags: _DesignFlags) -> int:
    """Plan the protocol that reaches a wanted precision in the least machine time.

    SOURCE is a bundle (its draws are the tissues to plan for) or a recipe; or give guesses with --tissue. On
    the path that the machine will take, model and noise say how precisely each indentation determines
    relaxation time, viscosity and the rest; speeds, depths, holds, repeats, rate and filter are searched.
    Exit code 4 where no protocol on this machine reaches the wants: the nearest one and what limits it are
    said.
    """
    from tissueid.design.document import design_document
    from tissueid.design.plan import planned

    machine, tissues, asked, given = _prepared(flags)
    out = None
    if flags.out is not None:
        out = made_folder(flags.out)
        # a study file that no plan wrote is not written over
        refuse_foreign(out, _FILES[1:], _FILES[0], "that no plan wrote")
    with progress_bar(show=not flags.quiet) as progress:
        started = datetime.now(UTC)
        plan = planned(machine, tissues, asked, progress)
        seconds = (datetime.now(UTC) - started).total_seconds()
    written = design_document(plan, machine, tissues, asked, given=given, specimens=flags.specimens)
    plain, document = checked(written, Design, where=_FILES[0])
    if out is not None:
        _write(out, plan, machine, tissues, asked, document)
        # last of all: a plan is there when it is
        write_file(out / _FILES[0], json_bytes(plain))
    if flags.as_json:
        echo_json(plain)
    elif not flags.quiet:
        print_plan(document)
    work = f"{plan.paths:,} paths and {plan.protocols:,} protocols in {seconds:.1f} s"
    note(f"looked at {work}" + ("" if out is None else f"; wrote {out}/{_FILES[1]}"), quiet=flags.quiet)
    if plan.best.reached:
        return 0
    note(f"no protocol on {machine.name!r} reaches what is wanted within the budget", quiet=flags.quiet)
    return NotIdentifiedError.exit_status


def _prepared(flags: _DesignFlags) -> tuple[Machine, Tissues, Asked, Against | None]:
    """Machine, tissues, wants and limits, and the protocol to compare with."""
    from tissueid.design.machine import found_machine
    from tissueid.design.plan import against, matched_wants
    from tissueid.design.precision import given_protocol
    from tissueid.design.tissues import given_recipe

    tissues, recipe = _tissues(flags)
    machine = found_machine(flags.machine)
    if flags.against is not None:
        recipe = given_recipe(flags.against)
    asked = _asked(flags, machine, tissues)
    if recipe is None:
        return machine, tissues, asked, None
    protocol = given_protocol(recipe)
    if not flags.wants:
        asked = replace(asked, wants=matched_wants(protocol, machine, tissues, asked))
    return machine, tissues, asked, against(recipe.name, protocol, machine, tissues, asked)


def _tissues(flags: _DesignFlags) -> tuple[Tissues, Recipe | None]:
    """Knowledge of the tissue, and the recipe it came from."""
    from tissueid.cli.calibrate_command import bundle_file
    from tissueid.design.tissues import given_recipe, of_bundle, of_recipe_tissue, parsed_guess, plain_guesses

    source, guesses = flags.source, flags.guesses
    if (source is None) == (not guesses):
        both = "both SOURCE and --tissue are given" if guesses else "nothing is said of the tissue"
        refuse(f"{both}: give a bundle or a recipe, or guesses as --tissue tau=0.02~30% (docs/design.md)")
    if guesses:
        found = [parsed_guess(text) for text in guesses]
        return plain_guesses(found, depth_mm=_positive(flags.max_depth, "max-depth"), count=flags.draws), None
    assert source is not None  # noqa: S101  (one of both was given)
    bundle = bundle_file(Path(source))
    if bundle is not None:
        return of_bundle(bundle, count=flags.draws), None
    recipe = given_recipe(source)
    return of_recipe_tissue(recipe), recipe


def _asked(flags: _DesignFlags, machine: Machine, tissues: Tissues) -> Asked:
    from tissueid.design.precision import Asked
    from tissueid.design.tissues import parsed_want, usual_wants

    default = [f"{name}={DEFAULT_WANT}" for name in usual_wants(tissues.model)]
    wants = tuple(parsed_want(text, tissues.model) for text in flags.wants or default)
    if len({want.name for want in wants}) < len(wants):
        refuse(f"--want names a number twice: {', '.join(flags.wants)}")
    for name, value in (
        ("recovery", flags.recovery), ("setup", flags.setup),
        ("gain-sd", flags.gain_sd), ("time-sd", flags.time_sd),
    ):  # fmt: skip
        if not 0.0 <= value < float("inf"):
            refuse(f"--{name} is {value}, must be 0 or above")
    return Asked(
        wants=wants,
        max_depth_mm=_positive(flags.max_depth, "max-depth") or tissues.model.depth_mm,
        max_force_N=min(_positive(flags.max_force, "max-force") or machine.max_force_N, machine.max_force_N),
        budget_s=_time(flags.budget),
        recovery_s=flags.recovery,
        setup_s=flags.setup,
        repeats=flags.repeats,
        max_logs=flags.max_logs,
        assurance=flags.assurance,
        gain_sd=flags.gain_sd,
        time_sd=flags.time_sd,
        total=flags.interval == "total",
    )


def _positive(value: float | None, name: str) -> float | None:
    if value is not None and not 0.0 < value < float("inf"):
        refuse(f"--{name} is {value}, must be above 0")
    return value


def _time(text: str) -> float:
    """``90min`` in seconds."""
    match = re.fullmatch(r"\s*([0-9]+\.?[0-9]*|\.[0-9]+)\s*(s|min|h)\s*", text)
    seconds = float(match[1]) * _UNITS[match[2]] if match else 0.0
    if seconds <= 0.0:
        refuse(f"--budget {text}: write a time above 0 with its unit, as 90min or 2h")
    return seconds


def _write(out: Path, plan: Plan, machine: Machine, tissues: Tissues, asked: Asked, document: Design) -> None:
    """All files of the plan but design.json."""
    from tissueid.design.document import has_recipe, recipe_text, study_text, test_sheet
    from tissueid.report.design_page import render_design

    texts = {
        "design.html": render_design(document, created=time_now()),
        "study.toml": study_text(plan.best, machine, asked, title=f"Plan for {tissues.name}"),
        "test-sheet.csv": test_sheet(plan.best, asked),
    }
    (out / "recipe.toml").unlink(missing_ok=True)
    if has_recipe(tissues.model):
        texts["recipe.toml"] = recipe_text(plan.best, machine, tissues, asked, name="planned")
    for name, text in texts.items():
        write_file(out / name, text.encode("utf-8"))


_SHORT = {"relaxation_time_s": "tau", "viscosity_N_s_per_mm": "eta", "stiffness_0_N_per_mm": "K"}
#: Limits that are printed; the page has them all.
PRINTED_LIMITS = 5


def short_name(name: str) -> str:
    """``tau_b2`` for the relaxation time of the second branch."""
    for full, short in _SHORT.items():
        if name == full or name.startswith(f"{full}_b"):
            return short + name.removeprefix(full)
    return name


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


def print_plan(document: Design) -> None:
    """Print the plan to stdout."""
    asked, best = document.asked, document.protocols[0]
    wanted = ", ".join(f"{short_name(one.name)} to {_percent(one.share)}" for one in asked.wants)
    echo(f"{document.tissue.name} on {document.machine.name}: {wanted} ({asked.interval})")
    if document.verdict.reached:
        said = f"recommended: {best.logs} logs, {time_words(best.seconds)} a specimen"
        if asked.specimens > 1:
            said += f", {time_words(best.total_seconds)} for {asked.specimens}"
    else:
        reached = ", ".join(f"{short_name(one.name)} to {_percent(one.assured)}" for one in best.precision)
        said = f"NONE on this machine reaches that; the nearest: {reached}"
    echo(said)
    heads = ["", "time", "logs", *(short_name(one.name) for one in asked.wants)]
    rows = [_row(str(rank), one) for rank, one in enumerate(document.protocols, start=1)]
    given = document.against
    shown = given is not None and given.protocol is not None
    if given is not None and given.protocol is not None:
        rows.append(_row(given.name, given.protocol))
    echo_table([*heads, "channel", "indentations"], rows, numbers=len(heads), dim_last=shown)
    if given is not None and not shown:
        echo(f"{given.name} can't be run here: {given.obstacle}")
    limits = document.verdict.limits
    if not limits and not document.verdict.reached:
        echo("no single change of machine or channel would help by a tenth")
    for one in limits[:PRINTED_LIMITS]:
        much = "that would be enough" if one.enough else f"{one.factor:.2g} times as precise"
        echo(f"limited by {one.name}: {one.words}: {much}")
    for remark in document.verdict.remarks:
        echo(f"note: {remark}")


def _row(rank: str, protocol: Protocol) -> list[str]:
    precision = [_percent(one.assured) for one in protocol.precision]
    setting = protocol.setting
    low_pass = f", filter {setting.filter_s:g} s" if setting.filter_s > 0.0 else ""
    channel = f"{setting.rate_Hz:g} Hz{low_pass}"
    indentations = "\n".join(f"{one.repeats} x {one.words}" for one in protocol.indentations)
    return [rank, time_words(protocol.seconds), str(protocol.logs), *precision, channel, indentations]
