"""``tissueid fit``."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from tissueid.cli.fit_summary import print_summary
from tissueid.cli.flags import OutputFlags, argument, option, takes
from tissueid.cli.output import echo_json_text, note, progress_bar
from tissueid.cli.quoting import QuotingFlags, quoting_values
from tissueid.cli.reading import (
    READING,
    PatternCheck,
    ReadingFlags,
    inputs_in_order,
    read_options,
    refuse_same_folder,
    segment_options,
)
from tissueid.errors import NotIdentifiedError, UsageError, exit_code

if TYPE_CHECKING:
    from tissueid.inference.posterior import PosteriorOptions
    from tissueid.manifest import Study
    from tissueid.pipeline import IdentifyOptions

EPILOG = """\b
Examples:
  tissueid fit lab_data/ -o out
  tissueid fit "session 3/"*.csv --branches 2 --stiffness-degree 1
  tissueid fit lab_data/study.toml -o out
  tissueid fit meat.xlsx --json > meat.json
  tissueid fit lab_data/ --model "polynomial * tangent * prony:2"
  tissueid fit lab_data/ --model auto
  tissueid fit rig/ --model "power * impact" -o wall
  tissueid fit odd.csv --columns "time=t,displacement=pos,force=F" --units "force=mN"
"""

#: A study of so many specimens is a cohort.
COHORT_FROM = 5
KELVIN_VOIGT = "kelvin-voigt"
REQUIRED = ["viscosity", "static", "stiffness", "relaxation-time", "none"]


def _count(auto: str) -> click.Choice[str]:
    return click.Choice([*auto, "auto"])


def _moved(_context: click.Context, _option: click.Parameter, value: str | None) -> None:
    """Refuse an option that became a model."""
    if value is not None:
        msg = f'--contact-law {value}: name 1 model instead, as --model "power * impact"'
        raise UsageError(msg)


@dataclass(frozen=True, kw_only=True)
class FitFlags(QuotingFlags, ReadingFlags, OutputFlags):
    """Flags of ``tissueid fit``."""

    # fmt: off
    paths: tuple[str, ...] = argument(nargs=-1, required=True, type=click.Path())
    out: str = option(
        "-o", "--out", type=click.Path(file_okay=False), default="tissueid-out", show_default=True,
        help="Output folder.",
    )
    model: str | None = option(
        "--model", metavar="NAME", show_default=KELVIN_VOIGT,
        help="Contact model: kelvin-voigt, STATIC * [STIFFNESS *] RELAXATION or STATIC * DAMPING of the "
            "laws in tissueid models; auto, or several with | between them, takes the one that predicts "
            "best.",
    )
    branches: str = option(
        "--branches", type=_count("123"), default="auto", show_default=True,
        help="Relaxation branches; auto chooses by held-out data.",
    )
    stiffness_degree: str = option(
        "--stiffness-degree", type=_count("012"), default="auto", show_default=True,
        help="Degree of the dynamic stiffness K(x); auto chooses by held-out data.",
    )
    static: str = option(
        "--static", type=click.Choice(["scaled", "partial", "shared"]), default="scaled", show_default=True,
        help="Own of each log: a curve of depth for static force and K, gain and contact, or contact.",
    )
    noise: str = option(
        "--noise", type=click.Choice(["auto", "white", "ar1", "white+ar1"]), default="auto",
        show_default=True, help="Noise of the force; auto takes what the residuals show.",
    )
    sampler: str = option(
        "--sampler", type=click.Choice(["emcee", "none"]), default="emcee", show_default=True,
        help="How the posterior is sampled; none gives standard errors only.",
    )
    draws: int = option(
        "--draws", type=click.IntRange(min=100), default=2_000, show_default=True,
        help="Effective posterior draws to go on for.",
    )
    require: tuple[str, ...] = option(
        "--require", multiple=True, type=click.Choice(REQUIRED),
        help="What must be identified for exit code 0. [default: viscosity and static]",
    )
    seed: int = option(
        "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of everything random.",
    )
    workers: int | None = option(
        "--workers", type=click.IntRange(min=1), metavar="N",
        help="Processes that compute specimens. [default: as many as processors, where the work is worth it]",
    )
    scheduler: str = option(
        "--scheduler", metavar="ADDRESS", default="local", show_default=True,
        help="Compute on a Dask cluster, as tcp://HOST:8786 (pip install 'tissueid[cluster]').",
    )
    population: str = option(
        "--population", type=click.Choice(["auto", "yes", "no"]), default="auto", show_default=True,
        help="What the specimens have in common, as tissueid cohort says it; auto does it for a study of "
            "five.",
    )
    mix_states: bool = option(
        "--mix-states", is_flag=True, help="Let a population pool thawed specimens with fresh ones.",
    )
    study: str | None = option(
        "--study", type=click.Path(), metavar="FILE",
        help="Study file. [default: study.toml of the folder that is fitted]",
    )
    no_study: bool = option("--no-study", is_flag=True, help="Fit without the folder's study.toml.")
    # fmt: on


@click.command("fit", epilog=EPILOG)
@click.option("--contact-law", hidden=True, expose_value=False, callback=_moved, help="Moved to --model.")
@takes(FitFlags)
def command(flags: FitFlags) -> int:
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

    quiet: int = flags.quiet
    reading = read_options(flags)
    study, paths = locate_study(flags.paths, named=flags.study, ignore=flags.no_study)
    if study is not None:
        flags = replace(flags, model=flags.model or study.model)
    flags = _checked_model(flags)
    options = _identify_options(flags)
    files = inputs_in_order(paths, study)
    _refuse_foreign(Path(flags.out))
    by_pattern = PatternCheck(reading.specimen_by, study)
    request = Request(
        files,
        reading,
        study,
        options,
        provenance={"reading": {key: getattr(flags, key) for key in READING}},
        workers=flags.workers,
        scheduler=flags.scheduler,
        read=by_pattern.add,
        all_read=by_pattern.say,
    )
    with OutputSet(flags.out) as run:
        with progress_bar(show=not quiet) as progress:
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
            print_summary(found, flags.out, quiet=quiet, verbose=flags.verbose)
    return exit_code({found.exit.code, _population(flags, study, found.fitted)})


def _population(flags: FitFlags, study: Study | None, fitted: int) -> int:
    """Write the population of the specimens beside them where it is wanted; its exit code."""
    wanted = flags.population
    if wanted == "auto":
        named = study is not None and fitted >= COHORT_FROM and flags.sampler != "none"
        wanted = "yes" if named else "no"
    if wanted == "no" or not fitted:
        return 0
    from tissueid.cli.population_lines import print_population
    from tissueid.study.cohort import PopulationRequest, write_population

    quiet = flags.quiet
    try:
        with progress_bar(show=not quiet) as progress:
            asked = PopulationRequest(seed=flags.seed, mix_states=flags.mix_states)
            written = write_population(Path(flags.out), asked, progress)
    except (NotIdentifiedError, UsageError) as error:
        note(error.message, quiet=quiet)
        return error.exit_status if flags.population == "yes" else 0
    if not flags.as_json:
        print_population(written, flags.out, quiet=quiet)
    return 0 if written.converged else NotIdentifiedError.exit_status


def _refuse_foreign(out: Path) -> None:
    """Files of our names in a folder that no run of ours made are somebody's: they stay."""
    if (out / ".current").exists() or not out.is_dir():
        return
    names = ("identification.json", "report.html", "curves.h5", "bundle*.h5")
    foreign = sorted(path.name for name in names for path in out.glob(name))
    if foreign:
        msg = (
            f"{out} holds {', '.join(foreign)} that tissueid did not write there: choose another folder "
            "with -o, or move them away"
        )
        raise UsageError(msg)


def _posterior_options(flags: FitFlags) -> PosteriorOptions | None:
    from tissueid.inference.posterior import PosteriorOptions

    if flags.sampler == "none":
        return None
    return PosteriorOptions(
        sampler=flags.sampler,
        draws=flags.draws,
        seed=flags.seed,
        workers=os.cpu_count() or 1,
    )


def _checked_model(flags: FitFlags) -> FitFlags:
    """Refuse a name that is no model and options that it does not take; settings of a file give way to it."""
    from tissueid.model.grammar import ModelNameError, candidates

    try:
        laws = candidates(flags.model or KELVIN_VOIGT)
    except ModelNameError as error:
        raise UsageError(str(error)) from None
    others = laws.paper is None or laws.choose
    if others and flags.unloading:
        msg = f"--unloading follows the surface of a kelvin-voigt model, not of {flags.model!r}"
        raise UsageError(msg)
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
        msg = f"{' and '.join(asked)}: {flags.model!r} says it already; leave one of them out"
        raise UsageError(msg)
    return flags


def _identify_options(flags: FitFlags) -> IdentifyOptions:
    from tissueid.inference.specimen import FitOptions
    from tissueid.pipeline import DEFAULT_REQUIRED, IdentifyOptions

    required = tuple(name for name in flags.require if name != "none")
    return IdentifyOptions(
        fit=FitOptions(
            model=flags.model or KELVIN_VOIGT,
            branches=None if flags.branches == "auto" else int(flags.branches),
            stiffness_degree=None if flags.stiffness_degree == "auto" else int(flags.stiffness_degree),
            static=flags.static,
            noise=flags.noise,
            **quoting_values(flags),
        ),
        segment=segment_options(flags),
        posterior=_posterior_options(flags),
        required=required if flags.require else DEFAULT_REQUIRED,
        seed=flags.seed,
    )
