"""``tissueid fit``: its options, the order of its work, and its closing lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
from click.core import ParameterSource

from tissueid.cli.flags import FOLDER, FROM_0, FROM_1, PATH, OutputFlags, argument, option, subcommand
from tissueid.cli.flags import typed as typed_flags
from tissueid.cli.output import echo, echo_json_text, note, progress_bar
from tissueid.cli.reading import (
    READING,
    PatternCheck,
    StudyFlags,
    inputs_in_order,
    read_options,
    refuse_same_folder,
    segment_options,
)
from tissueid.digits import with_error
from tissueid.documents import typed
from tissueid.documents.identification import Exclusion, Specimen
from tissueid.errors import NotIdentifiedError, UsageError, exit_code, refuse
from tissueid.report.specimen_lines import shared_codes, shared_lines, specimen_lines
from tissueid.report.wording import whole_label
from tissueid.store.outputs import refuse_unwritten
from tissueid.store.results import load_identification

if TYPE_CHECKING:
    from tissueid.manifest import Study
    from tissueid.measured.geometry import Geometry
    from tissueid.pipeline import IdentifyOptions
    from tissueid.study.batch import Assembled

#: A study of so many specimens is a cohort.
COHORT_FROM = 5
KELVIN_VOIGT = "kelvin-voigt"
_FILES = ("identification.json", "report.html", "curves.h5", "bundle*.h5")


def _moved(_context: click.Context, _option: click.Parameter, value: str | None) -> None:
    """Refuse an option that became a model."""
    if value is not None:
        refuse(f'--contact-law {value}: name 1 model instead, as --model "power * impact"')


class _FitFlags(StudyFlags, OutputFlags):
    # fmt: off
    contact_law: None = option("Moved to --model.", hidden=True, type=str, callback=_moved)
    paths: tuple[str, ...] = argument(required=True, type=PATH)
    out: str = option("Output folder.", "-o", type=FOLDER, default="tissueid-out")
    model: str | None = option(
        "Contact model: kelvin-voigt, STATIC * [STIFFNESS *] RELAXATION or STATIC * DAMPING of the laws in "
        "tissueid models; auto, or several with | between them, takes the one that predicts best.",
        metavar="NAME", show_default=KELVIN_VOIGT,
    )
    branches: Literal["1", "2", "3", "auto"] = option(
        "Relaxation branches; auto chooses by held-out data.", default="auto"
    )
    stiffness_degree: Literal["0", "1", "2", "auto"] = option(
        "Degree of the dynamic stiffness K(x); auto chooses by held-out data.", default="auto"
    )
    static: Literal["auto", "scaled", "partial", "shared"] = option(
        "Own of each log: a curve of depth and a factor of times (auto, where a speed is repeated), gain and"
        " contact (auto, where none is), or contact.",
        default="auto",
    )
    orders: Literal["study", "own"] = option(
        "Law and order of a study's specimens: the one that predicts best over all, or each its own.",
        default="study",
    )
    noise: Literal["auto", "white", "ar1", "white+ar1"] = option(
        "Noise of the force; auto takes what the residuals show.", default="auto"
    )
    sampler: Literal["emcee", "none"] = option(
        "How the posterior is sampled; none gives standard errors only.", default="emcee"
    )
    draws: int = option(
        "Effective posterior draws to go on for.", type=click.IntRange(min=100), default=2_000
    )
    require: tuple[Literal["viscosity", "static", "stiffness", "relaxation-time", "none"], ...] = option(
        "What must be identified for exit code 0. [default: viscosity and static]"
    )
    seed: int = option("Seed of everything random.", type=FROM_0, default=0)
    workers: int | None = option(
        "Processes that compute specimens. [default: as many as processors, where the work is worth it]",
        type=FROM_1, metavar="N",
    )
    scheduler: str = option(
        "Compute on a Dask cluster, as tcp://HOST:8786 (pip install 'tissueid[cluster]').",
        metavar="ADDRESS", default="local",
    )
    population: Literal["auto", "yes", "no"] = option(
        "What the specimens have in common, as tissueid cohort says it; auto does it for a study of five.",
        default="auto",
    )
    mix_states: bool = option("Let a population pool thawed specimens with fresh ones.")
    # numbers that are quoted beside those of the model
    unloading: bool = option("Fit retracts and cycles as well, with the law of contact loss.")
    frequencies: str | None = option(
        "Frequencies [Hz] of storage and loss stiffness, as 0.1,1,10. [default: those the data support]",
        metavar="LIST",
    )
    depths: str | None = option("Depths [mm] at which each loop's stiffness is given.", metavar="LIST")
    tip: str | None = option(
        "Tip, for moduli: sphere:RADIUS, flat:RADIUS [mm] or cone:HALF-ANGLE [degrees].", metavar="SHAPE:SIZE"
    )
    thickness: float | None = option("Thickness of the layer under --tip.", metavar="MM")
    poisson: float = option(
        "Poisson's ratio behind the moduli.", type=click.FloatRange(0.0, 0.5), default=0.5
    )
    # fmt: on


@subcommand(
    "fit",
    "lab_data/ -o out",
    '"session 3/"*.csv --branches 2 --stiffness-degree 1',
    "lab_data/study.toml -o out",
    "meat.xlsx --json > meat.json",
    'lab_data/ --model "polynomial * tangent * prony:2"',
    "lab_data/ --model auto",
    'rig/ --model "power * impact" -o wall',
    'odd.csv --columns "time=t,displacement=pos,force=F" --units "force=mN"',
)
def command(flags: _FitFlags) -> int:
    """Identify the tissue behind recordings.

    PATHS are exports, workbooks, folders of them, or a study.toml. Each file or sheet is its own specimen
    unless their headers carry the same specimen label, --specimen-by groups them, or a study does. Writes
    identification.json, one bundle a specimen, curves.h5, posteriors.h5 and report.html to the
    output folder, all at once or not at all.
    """
    refuse_same_folder(flags.paths, flags.out)
    from tissueid.store.outputs import OutputSet
    from tissueid.study.batch import fit_cohort, prune_specimens
    from tissueid.study.inventory import Request
    from tissueid.study.pages import write_report
    from tissueid.study.recordings import locate_study

    reading = read_options(flags)
    study, paths = locate_study(flags.paths, named=flags.study, ignore=flags.no_study)
    if study is not None:
        flags = replace(flags, model=flags.model or study.model)
    flags = _checked(flags)
    options = _identify_options(flags)
    files = inputs_in_order(paths, study)
    refuse_unwritten(Path(flags.out), _FILES)
    by_pattern = PatternCheck(reading.specimen_by, study)
    request = Request(
        files,
        reading,
        study,
        options,
        provenance={"reading": {key: getattr(flags, key) for key in READING}},
        workers=flags.workers,
        scheduler=flags.scheduler,
        one_order=flags.orders == "study",
        read=by_pattern.add,
        all_read=by_pattern.say,
    )
    with OutputSet(flags.out) as run:
        with progress_bar(show=not flags.quiet) as progress:
            found = fit_cohort(request, run, progress)
            if found.fitted:
                progress("writing the report", 0, 0)
                write_report(run, [str(one) for one in found.refused])
        if found.fitted:
            run.commit()
            prune_specimens(run.out)
        if flags.as_json:
            echo_json_text(found.document.read_text(encoding="utf-8"))
        else:
            print_summary(found, flags.out, quiet=flags.quiet, verbose=flags.verbose)
    return exit_code({found.exit.code, _population(flags, study, found.fitted)})


def _population(flags: _FitFlags, study: Study | None, fitted: int) -> int:
    """Write the population of the specimens beside them where it is wanted; its exit code."""
    wanted = flags.population
    if wanted == "auto":
        named = study is not None and fitted >= COHORT_FROM and flags.sampler != "none"
        wanted = "yes" if named else "no"
    if wanted == "no" or not fitted:
        return 0
    from tissueid.cli.cohort_command import print_population
    from tissueid.population.cohort import CohortOptions
    from tissueid.population.sampler import SamplerOptions
    from tissueid.study.cohort import write_population

    try:
        with progress_bar(show=not flags.quiet) as progress:
            options = CohortOptions(sampler=SamplerOptions(seed=flags.seed))
            written = write_population(Path(flags.out), options, progress, mix_states=flags.mix_states)
    except (NotIdentifiedError, UsageError) as error:
        note(error.message, quiet=flags.quiet)
        return error.exit_status if flags.population == "yes" else 0
    if not flags.as_json:
        print_population(written, flags.out, quiet=flags.quiet)
    return 0 if written.converged else NotIdentifiedError.exit_status


def _checked(flags: _FitFlags) -> _FitFlags:
    """Refuse a name that is no model and options that are of none; settings of a file give way to it."""
    from tissueid.model.grammar import ModelNameError, candidates

    try:
        laws = candidates(flags.model or KELVIN_VOIGT)
    except ModelNameError as error:
        refuse(str(error))
    if flags.sampler == "none" and (said := typed_flags("draws")):
        refuse(f"{said[0]} is of a sampler, and --sampler none takes no draws: leave one of them out")
    if flags.population == "no" and flags.mix_states:
        refuse("--mix-states is of a population, and --population no makes none: leave one of them out")
    if flags.unloading and (laws.paper is None or laws.choose):
        refuse(f"--unloading follows the surface of a kelvin-voigt model, not of {flags.model!r}")
    if laws.paper is not None and laws.paper.branches is None:
        return flags
    context, asked = click.get_current_context(), []
    for key in ("branches", "stiffness_degree"):
        if context.get_parameter_source(key) in {ParameterSource.DEFAULT_MAP, ParameterSource.ENVIRONMENT}:
            # what is said here, or in the study, comes first
            automatic: dict[str, Any] = {key: "auto"}
            flags = replace(flags, **automatic)
        elif getattr(flags, key) != "auto":
            asked.append(f"--{key.replace('_', '-')}")
    if asked:
        refuse(f"{' and '.join(asked)}: {flags.model!r} says it already; leave one of them out")
    return flags


def _identify_options(flags: _FitFlags) -> IdentifyOptions:
    from tissueid.inference.posterior import PosteriorOptions
    from tissueid.inference.specimen import FitOptions
    from tissueid.pipeline import DEFAULT_REQUIRED, IdentifyOptions

    required = tuple(name for name in flags.require if name != "none")
    sampled = PosteriorOptions(flags.sampler, flags.draws, flags.seed) if flags.sampler != "none" else None
    return IdentifyOptions(
        fit=FitOptions(
            model=flags.model or KELVIN_VOIGT,
            branches=None if flags.branches == "auto" else int(flags.branches),
            stiffness_degree=None if flags.stiffness_degree == "auto" else int(flags.stiffness_degree),
            static=flags.static,
            noise=flags.noise,
            unloading=flags.unloading,
            frequencies_Hz=_numbers(flags.frequencies, "--frequencies"),
            depths_mm=_numbers(flags.depths, "--depths"),
            geometry=_geometry(flags),
            poisson=flags.poisson,
        ),
        segment=segment_options(flags),
        posterior=sampled,
        required=required if flags.require else DEFAULT_REQUIRED,
        seed=flags.seed,
    )


def _numbers(text: str | None, option: str) -> tuple[float, ...]:
    """A list of positive numbers as typed."""
    if text is None:
        return ()
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if not values or not all(0.0 < value < float("inf") for value in values):
        refuse(f"{option} takes positive numbers with commas between, as 0.1,1,10; got {text!r}")
    return values


def _geometry(flags: _FitFlags) -> Geometry | None:
    """Tip and thickness as typed."""
    from tissueid.measured.geometry import Geometry
    from tissueid.model.moduli import Indenter

    if flags.tip is None:
        if flags.thickness is not None:
            refuse("--thickness needs --tip; a study.toml may hold both, a thickness for each specimen")
        return None
    shape, _, size = flags.tip.partition(":")
    try:
        number = float(size)
        tip = Indenter(shape, half_angle_deg=number) if shape == "cone" else Indenter(shape, number)
        return Geometry(tip, flags.thickness, flags.poisson)
    except ValueError as error:
        refuse(f"--tip {flags.tip}: {error}; write sphere:3 or flat:2 (radius in mm), or cone:45 (degrees)")


#: Specimens from which on each gets one line of what was measured.
MANY = 4
_COLOURS = {"alarm": "red", "serious": "red", "remark": "yellow"}


def print_summary(found: Assembled, out: str, *, quiet: int, verbose: int) -> None:
    """Numbers to stdout, what was left out and what is missing to stderr."""
    if found.beside:
        note(
            f"{found.beside} of {found.trials} trials are not named by the study and were fitted as well "
            "(only_listed = true leaves them out)",
            quiet=quiet,
        )
    if not quiet:
        if found.large:
            echo(f"{found.fitted} of {found.jobs} specimens fitted")
        elif found.fitted:
            _print_specimens(load_identification(found.document).specimens, verbose=verbose)
        for row in typed(found.exclusions, tuple[Exclusion, ...]):
            echo()
            echo(f"excluded  {whole_label(row)}: {row.because}")
            if row.note:
                echo(f"  {row.note}")
            for one in row.with_it:
                before = with_error(one.without, one.without_stderr)
                after = with_error(one.with_it, one.with_stderr)
                unit = "" if one.with_it is None else f" {one.unit}"
                echo(f"  {one.symbol:<6} with it {after}{unit} (without: {before})")
        if found.fitted:
            echo()
            echo(f"Report: {out}/report.html")
    print_reasons(found, quiet=quiet)


def _print_specimens(specimens: Sequence[Specimen], *, verbose: int) -> None:
    shared = () if verbose else shared_codes(specimens)
    brief = len(specimens) >= MANY and not verbose
    for specimen in specimens:
        echo()
        for one in specimen_lines(specimen, shared, verbose=verbose, brief=brief):
            echo(one.text, fg=_COLOURS.get(one.kind), bold=one.kind in {"title", "alarm"})
    if shared:
        echo()
        echo(f"all {len(specimens)} specimens")
        for line in shared_lines(specimens, shared):
            echo(f"  ! {line}", fg="yellow")
    if not verbose and any(specimen.sampler is not None for specimen in specimens):
        echo("In brackets: 95 % intervals, with what is not known of the machine; -v prints both kinds.")


def print_reasons(found: Assembled, *, quiet: int) -> None:
    """On stderr: every refused input, and why else the exit code is not 0."""
    for one in found.refused:
        echo(f"refused ({one.code})  {one}", fg="red", err=True)
    told = {str(one) for one in found.refused}
    same: dict[str, list[str]] = {}
    for reason in found.exit.reasons:
        specimen, separator, missing = reason.rpartition(": not identified: ")
        if separator and reason not in told:
            same.setdefault(missing, []).append(specimen)
        elif reason not in told:
            note(reason, quiet=quiet)
    for missing, specimens in same.items():
        # each is named, however many they are
        note(f"{'; '.join(specimens)}: not identified: {missing}", quiet=quiet)
