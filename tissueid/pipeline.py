"""The stages in their order: recordings in, an identification out.

No mathematics and no paths here.  Trials come as an iterable; where a ``reload`` is given, samples are
kept only while they fit in a small cache and are read again when needed, so that the memory of a study
does not grow with it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tissueid import __version__, collection
from tissueid.decided import arithmetic_refusal
from tissueid.documents import members, typed
from tissueid.documents.identification import Exit, TipGeometry
from tissueid.errors import InputError, exit_code, refuse
from tissueid.extras import versions
from tissueid.inference.frame_effect import tip_handles
from tissueid.inference.logs import NO_CONTACT, LogHandle
from tissueid.inference.posterior import PosteriorOptions, with_posterior
from tissueid.inference.prior import calibration_priors
from tissueid.inference.specimen import FitOptions, FittedSpecimen, fit_with_state
from tissueid.inference.verdict import unsampled
from tissueid.manifest import Study
from tissueid.measured.geometry import stated_geometry
from tissueid.model.grammar import KELVIN_VOIGT, candidates, unused_priors
from tissueid.priors import Priors
from tissueid.result import Identification, Refusal, SpecimenFit
from tissueid.segment import SegmentOptions
from tissueid.trial import Axes, Source, Trial

#: Libraries whose version may change a number.
LIBRARIES = ("emcee", "lmfit", "numba", "numpy", "scipy")
REQUIRABLE = ("viscosity", "static", "stiffness", "relaxation-time")
DEFAULT_REQUIRED = ("viscosity", "static")
#: What a bundle keeps of its study.
STUDY_PROVENANCE = ("path", "sha256", "calibration", "priors")
#: Beginnings of parameters; what resists speed in a law without branches is its damping.
_PREFIX: dict[str, str | tuple[str, ...]] = {
    "viscosity": ("viscosity", "damping"),
    "static": "static",
    "stiffness": "stiffness",
    "relaxation-time": "relaxation_time",
}


@dataclass(frozen=True, slots=True)
class IdentifyOptions:
    """Options of a run.

    Attributes
    ----------
    fit : FitOptions
    segment : SegmentOptions
    posterior : PosteriorOptions or None
        How posteriors are sampled; ``None`` leaves them out.
    required : tuple of str
        What must be identified for exit code 0, of :data:`REQUIRABLE`.
    seed : int
        Seed of everything random; recorded, and without effect where nothing is drawn.
    """

    fit: FitOptions = field(default_factory=FitOptions)
    segment: SegmentOptions = field(default_factory=SegmentOptions)
    posterior: PosteriorOptions | None = None
    required: tuple[str, ...] = DEFAULT_REQUIRED
    seed: int = 0


Checkpoints = Callable[[str], Path]


def unmet(specimens: Sequence[SpecimenFit], required: Sequence[str]) -> list[str]:
    """Requested numbers that are not identified, or did not converge, in words."""
    reasons = []
    prefixes = tuple(_PREFIX[name] for name in required)
    for fit in specimens:
        for prefix in prefixes:
            asked = [one for one in fit.parameters if one.name.startswith(prefix)]
            if asked and not any(one.identified for one in asked):
                reasons.append(f"{fit.specimen}: not identified: {', '.join(one.name for one in asked)}")
        if fit.posterior is not None and not fit.posterior.sampler.converged:
            why = fit.posterior.sampler.detail.get("reason", "its rule was not met")
            reasons.append(f"{fit.specimen}: the sampler did not converge: {why}")
        if any(flag.code == "not_converged" for flag in fit.flags):
            reasons.append(f"{fit.specimen}: Levenberg-Marquardt did not converge")
    return reasons


def exit_of(fitted: int, refused: Sequence[str], missing: Sequence[str], excluded: int = 0) -> Exit:
    """End of a run."""
    codes: set[int] = {0}
    reasons = list(refused)
    if refused:
        codes.add(7 if fitted else 3)
    elif not fitted:
        codes.add(3)
        none = f"nothing is left to fit: {excluded} excluded" if excluded else "no recording was found"
        reasons.append(none)
    if missing:
        codes.add(4)
    return typed({"code": exit_code(codes), "reasons": (*reasons, *missing)}, Exit)


def run_provenance(
    options: IdentifyOptions, inputs: Any, record: Mapping[str, Any] | None, extra: Mapping[str, Any]
) -> dict[str, Any]:
    """The ``provenance`` of a run: versions, options, inputs, and what its study says of all specimens.

    ``inputs``: one row a recording that was fitted; ``record``: the ``study`` of the run; ``extra``: what the
    caller adds.
    """
    fit, posterior = options.fit, options.posterior
    return {
        "tissueid": __version__,
        "versions": versions(LIBRARIES),
        "options": {
            "model": fit.model,
            "branches": fit.branches or "auto",
            "stiffness_degree": "auto" if fit.stiffness_degree is None else fit.stiffness_degree,
            "static": fit.static,
            "noise": fit.noise,
            "sampler": "none" if posterior is None else posterior.sampler,
            "draws": 0 if posterior is None else posterior.draws,
            "unloading": fit.unloading,
            "frequencies_Hz": list(fit.frequencies_Hz),
            "depths_mm": list(fit.depths_mm),
            "tip": None if fit.geometry is None else str(fit.geometry),
            "poisson": fit.poisson,
            "compression_sign": options.segment.compression_sign,
            "contact_displacement_mm": options.segment.contact_displacement_mm,
            "required": list(options.required),
            "seed": options.seed,
        },
        "inputs": inputs,
        **({} if record is None else {"study": {key: record[key] for key in STUDY_PROVENANCE}}),
        **extra,
    }


def _fit(
    name: str,
    handles: Sequence[LogHandle],
    fit: FitOptions,
    study: Study | None,
    tick: Callable[[str], None],
    *,
    normalised: bool,
) -> FittedSpecimen:
    """Fit one specimen in the displacement of the tip."""
    frame = None if study is None else study.calibration.frame
    if frame is not None:
        handles = tip_handles(handles, frame, tick)
    return fit_with_state(
        name, handles, options=fit, priors=_priors(study), machine=not normalised, tick=tick
    )


def refuse_unused(model: str | None, study: Study | None) -> None:
    """UsageError where a study states a prior of a parameter that the fitted law does not have."""
    priors, laws = _priors(study), candidates(model or KELVIN_VOIGT)
    unused = unused_priors(laws, (*priors.linear, *priors.shapes))
    if unused:
        refuse(
            f"{'' if study is None else study.path}: [priors.{unused[0]}] is of no parameter of "
            f"{model or KELVIN_VOIGT}; take it out, or name a law that has it (`tissueid models`)"
        )


def _priors(study: Study | None) -> Priors:
    """Priors of tissue and machine."""
    priors = Priors() if study is None else study.priors
    return replace(priors, calibration=calibration_priors(None if study is None else study.calibration))


def with_draws(
    fitted: FittedSpecimen,
    options: PosteriorOptions | None,
    priors: Priors,
    *,
    instrument: bool,
    checkpoint: Path | None = None,
    key: str = "",
    tick: Callable[[str], None] | None = None,
) -> SpecimenFit:
    """A fit with its posterior, where one is asked for; where none can be drawn, the fit and why."""
    if options is None:
        return fitted.fit
    try:
        return with_posterior(
            fitted,
            priors=priors,
            instrument=instrument,
            options=options,
            checkpoint=checkpoint,
            key=key,
            tick=tick,
        )
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        # the fit stands without its posterior; what is lost is said
        return unsampled(fitted.fit, error)


def _identity(
    inputs: Sequence[Mapping[str, Any]], specimen: str, options: IdentifyOptions, study: Study | None
) -> str:
    """Hash of what the posterior of a specimen depends on: a chain of another one is not gone on with."""
    own = sorted(
        (entry["path"], entry["sheet"] or "", entry["sha256"])
        for entry in inputs
        if entry["specimen"] == specimen
    )
    said = "" if study is None else study.sha256
    libraries = [__version__, *versions(LIBRARIES).values()]
    return hashlib.sha256(repr((own, said, libraries, options)).encode()).hexdigest()


def with_model(options: IdentifyOptions, study: Study | None) -> IdentifyOptions:
    """Options that name their contact model: the one asked for, else the study's, else Kelvin-Voigt."""
    said = options.fit.model or (study.model if study is not None else None) or KELVIN_VOIGT
    return replace(options, fit=replace(options.fit, model=said))


def _own_options(options: FitOptions, study: Study | None, name: str, axes: Axes) -> FitOptions:
    """Options with the tip and the thickness of one specimen."""
    if axes.normalised:
        # stress over strain is a modulus already
        return replace(options, geometry=None)
    if study is None or options.geometry is not None:
        return options
    thickness = study.specimens.get(name, {}).get("thickness_mm")
    geometry = stated_geometry(study.tip, thickness, options.poisson)
    return replace(options, geometry=geometry, header_tip=not study.tip)


def _fit_all(
    collected: collection.Collected,
    names: Mapping[str, str],
    options: IdentifyOptions,
    study: Study | None,
    progress: collection.Progress,
    checkpoint: Checkpoints | None,
) -> list[SpecimenFit]:
    """Fit every specimen; one whose numbers defeat the arithmetic is refused, and the rest goes on."""
    fits: list[SpecimenFit] = []
    total = len(collected.groups)
    for done, (specimen, handles) in enumerate(collected.groups.items()):
        name = names[specimen]

        def tick(message: str, *, name: str = name, done: int = done) -> None:
            progress(f"{name}: {message}", done, total)

        tick("fitting")
        axes = collected.axes[specimen]
        try:
            own = _own_options(options.fit, study, name, axes)
            fitted = _fit(name, handles, own, study, tick, normalised=axes.normalised)
            fit = with_draws(
                fitted,
                options.posterior,
                _priors(study),
                instrument=not axes.normalised,
                checkpoint=None if checkpoint is None else checkpoint(fitted.bare.specimen),
                key=_identity(collected.inputs, specimen, options, study),
                tick=tick,
            )
        except InputError as error:
            if error.code != NO_CONTACT:
                raise
            collected.left_out.append(Refusal.of(error))
            continue
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            collected.left_out += [
                arithmetic_refusal(entry["path"], entry["sheet"], "fitted", error)
                for entry in collected.inputs
                if entry["specimen"] == specimen
            ]
            continue
        radii = set(collected.radii[specimen])
        radius_mm, tip = radii.pop() if len(radii) == 1 else None, None
        if own.geometry is not None:
            said = own.geometry.indenter
            radius_mm, tip = radius_mm or said.radius_mm, typed(members(said, TipGeometry), TipGeometry)
        fit = replace(fit, tip_radius_mm=radius_mm, tip=tip, axes=axes)
        fits.append(collection.study_flags(fit, collected, study))
    progress("fitted", total, total)
    return fits


def identify(
    trials: Iterable[Trial],
    *,
    study: Study | None = None,
    options: IdentifyOptions | None = None,
    reload: Callable[[Source], Trial] | None = None,
    refused: Sequence[Refusal] = (),
    provenance: Mapping[str, Any] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    checkpoint: Checkpoints | None = None,
    names: Mapping[str, str] | None = None,
) -> Identification:
    """Identify the contact model of every specimen among the trials.

    Parameters
    ----------
    trials : iterable of Trial
        Trials of one specimen are fitted together.
    study : Study, optional
        What a study file says of them; see :func:`tissueid.read_study`.
    options : IdentifyOptions, optional
    reload : callable, optional
        Reads a trial again from its source; without it all samples stay in memory.
    refused : sequence of Refusal, optional
        Inputs refused while ``trials`` was read; looked at after the iteration has ended.
    provenance : mapping, optional
        Added to the versions, options and inputs that are recorded anyway.
    progress : callable, optional
        ``progress(message, done, total)``; total is 0 while it is not known.
    checkpoint : callable, optional
        Gives the file in which a specimen's chain is kept while it is sampled, by the specimen's name.
    names : mapping, optional
        Specimen of a trial -> its name as shown, where the trials are part of a larger set.

    Returns
    -------
    Identification
        Its ``exit`` says whether something was left out or not identified.
    """
    options = with_model(options or IdentifyOptions(), study)
    refuse_unused(options.fit.model, study)
    progress = progress or (lambda _message, _done, _total: None)
    collected = collection.collect(
        trials,
        options.segment,
        collection.TrialCache(reload),
        progress,
        study,
        depths_mm=options.fit.depths_mm,
        unloading=options.fit.unloading,
    )
    names = collection.display_names(collected.sources) if names is None else names
    fits = _fit_all(collected, names, options, study, progress, checkpoint)
    normalised = {fit.specimen: fit.axes.normalised for fit in fits}

    def fit_again(name: str, handles: Sequence[LogHandle], fit: FitOptions, because: str) -> SpecimenFit:
        def tick(text: str) -> None:
            progress(f"{name} {because}: {text}", 0, 0)

        return _fit(name, handles, fit, study, tick, normalised=normalised[name]).fit

    kept = collection.without_excluded(refused, collected, study)
    exclusions = collection.exclusion_rows(collected, names, fits, options.fit, fit_again)
    inputs = [entry | {"specimen": names[entry["specimen"]]} for entry in collected.inputs]
    everything = [*kept, *collected.left_out, *collection.unmatched_sheets(study, collected, refused)]
    record = None if study is None else collection.study_record(study, collected, names, exclusions)
    return Identification(
        specimens=tuple(fits),
        refused=tuple(everything),
        unfitted_cycles=tuple(collected.unfitted_cycles),
        exclusions=tuple(exclusions),
        exit=exit_of(
            len(fits), [str(one) for one in everything], unmet(fits, options.required), len(exclusions)
        ),
        study=record,
        provenance=run_provenance(options, inputs, record, provenance or {}),
    )
