"""Ten-line interface: read recordings, fit a contact model, look at it, sample it, keep it, feel it.

::

    import tissueid as ti
    trials = ti.read("lab_data/")
    fit = ti.fit(trials)
    print(fit)
    sampled = fit.sample()
    ti.Bundle(fit, sampled).save("liver.h5")
    ti.render("liver.h5", device="sim")

Everything stands on the functions of the command line; a whole study with its specimens is
:func:`tissueid.identify`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.collection import TrialCache, collect, display_names
from tissueid.digits import typeset
from tissueid.documents import plain, typed
from tissueid.documents.identification import Specimen
from tissueid.errors import BundleError, InputError, NotIdentifiedError, refuse
from tissueid.flags import Flag
from tissueid.inference.logs import LogHandle
from tissueid.inference.posterior import PosteriorOptions
from tissueid.inference.reported import at_samples, half_width, reported_draws
from tissueid.inference.specimen import FitOptions, FittedSpecimen, fit_with_state, force_along
from tissueid.ingest import ReadOptions, find_inputs, read_each
from tissueid.manifest import Study
from tissueid.model.base import branch_suffix
from tissueid.model.composed import ContactModel
from tissueid.notebook import MEASURED, MODEL, drawing, html_of, svg_file
from tissueid.pipeline import IdentifyOptions, refuse_unused, run_provenance, with_draws, with_model
from tissueid.priors import Priors, SpreadPrior
from tissueid.report.specimen_lines import specimen_lines
from tissueid.result import Estimate, Refusal, SpecimenFit
from tissueid.segment import SegmentOptions
from tissueid.store.bundle import bundle_from_fit, load_bundle, write_bundle
from tissueid.store.files import write_file
from tissueid.trial import Trial
from tissueid.uncertainty import ParameterUncertainty, Posterior

if TYPE_CHECKING:
    from tissueid.rendering.session import Outcome
    from tissueid.store.bundle import Bundle as BundleContent

#: Relative standard deviation of a parameter that is fixed.
FIXED = 1e-6


class Trials(list[Trial]):
    """Recordings that were read, in the order of their files; ``refused``: errors of those that were not."""

    def __init__(self, trials: Iterable[Trial], refused: Iterable[InputError] = ()) -> None:
        super().__init__(trials)
        self.refused = tuple(refused)


def read(path: str | Path, options: ReadOptions | None = None) -> Trials:
    """Read a recording, a workbook, or every recording of a folder.

    Parameters
    ----------
    path : str or Path
    options : ReadOptions, optional
        Columns and units that a file does not say.

    Returns
    -------
    Trials
        A list of :class:`Trial`; what was refused stands in its ``refused``.

    Raises
    ------
    UsageError
        There is no such path.
    InputError
        Nothing could be read: the first refusal.
    """
    every = [one for file in find_inputs([path]) for one in read_each(file, options)]
    refused = [one for one in every if isinstance(one, InputError)]
    found = [one for one in every if isinstance(one, Trial)]
    if refused and not found:
        raise refused[0]
    return Trials(found, refused)


def fit(
    trials: Trial | Iterable[Trial],
    model: ContactModel | str | None = None,
    *,
    specimen: str | None = None,
    options: FitOptions | None = None,
    segment: SegmentOptions | None = None,
    priors: Priors | None = None,
) -> Fit:
    """Fit one contact model to recordings of one specimen.

    Parameters
    ----------
    trials : Trial or iterable of Trial
        All of them are pooled, whatever specimen they name.
    model : ContactModel or str, optional
        None is the modified Kelvin-Voigt model, whose order is chosen (``Fit.selection`` says why); ``auto``,
        or names with ``|`` between them, are chosen among.
    specimen : str, optional
        Its name; by default that of the recordings.
    options : FitOptions, optional
        Pooling, noise, tip; its ``model`` gives way to ``model``.
    segment : SegmentOptions, optional
        Overrides of contact, signs and times.
    priors : Priors, optional
        What is believed beforehand of tissue and machine.

    Raises
    ------
    InputError
        No recording can be fitted: the first reason.
    UsageError
        There are no recordings, displacement and force differ in their units, or a prior is of no parameter
        of the model.
    """
    options = options or FitOptions()
    if model is not None:
        options = replace(options, model=str(model))
    refuse_unused(options.model, Study("tissueid.fit", priors=priors or Priors()))
    given = [trials] if isinstance(trials, Trial) else list(trials)
    if not given or not all(isinstance(one, Trial) for one in given):
        refuse("there are no recordings to fit; read some with tissueid.read(folder)")
    known = set(display_names([(one.specimen, one.source) for one in given]).values())
    name = specimen or (known.pop() if len(known) == 1 else "specimen")
    pooled = [replace(one, specimen=name) for one in given]
    cut = segment or SegmentOptions()
    found = collect(
        pooled, cut, TrialCache(None), lambda *_: None,
        depths_mm=options.depths_mm, unloading=options.unloading,
    )  # fmt: skip
    if not found.groups:
        raise found.left_out[0].as_error()
    if any(one.code == "mixed_axes" for one in found.left_out):
        refuse("recordings of lengths and of strains can't be fitted together; fit each kind by itself")
    # by themselves: recordings that are no files have one and the same path
    fitted_ones = {id(handle.load()) for handle in found.groups[name]}
    own = tuple(one for one, named in zip(given, pooled, strict=True) if id(named) in fitted_ones)
    setting = _Setting(options, cut, priors or Priors(), tuple(found.inputs), not found.axes[name].normalised)
    fitted = fit_with_state(
        name, found.groups[name], options=options, priors=setting.priors, machine=setting.machine
    )
    fitted = replace(fitted, bare=replace(fitted.bare, axes=found.axes[name]))
    return Fit(own, tuple(found.left_out), setting, fitted)


@dataclass(frozen=True, slots=True)
class _Setting:
    """Surroundings of a fit: what it was asked for with."""

    options: FitOptions
    segment: SegmentOptions
    priors: Priors
    inputs: tuple[Mapping[str, Any], ...]
    machine: bool

    def provenance(self, posterior: PosteriorOptions | None) -> dict[str, Any]:
        """The provenance of a bundle."""
        asked = with_model(IdentifyOptions(fit=self.options, segment=self.segment, posterior=posterior), None)
        return run_provenance(asked, [dict(one) for one in self.inputs], None, {})


class _Reported:
    """Numbers of a specimen by name or symbol, and the lines of the command."""

    result: SpecimenFit

    def __str__(self) -> str:
        lines = specimen_lines(typed(plain(self.result.as_json()), Specimen))
        return "\n".join(typeset(line.text) for line in lines)

    def _repr_html_(self) -> str:
        return html_of(self.result)

    def parameter(self, name: str) -> Estimate:
        """A reported parameter, by name (``relaxation_time_s``) or symbol (``tau``).

        Raises KeyError: there is none; the message lists those that there are.
        """
        axes = self.result.axes
        for one in self.result.parameters:
            if name in {one.name, one.symbol}:
                return replace(one, unit=axes.unit(one.unit)) if axes.normalised else one
        known = ", ".join(f"{one.symbol} ({one.name})" for one in self.result.parameters)
        raise KeyError(f"no parameter {name!r}; there are {known}")

    @property
    def flags(self) -> tuple[Flag, ...]:
        """Remarks on the specimen."""
        return self.result.flags

    @property
    def selection(self) -> tuple[Mapping[str, Any], ...]:
        """Candidates with their scores on what was left out; the chosen one says so."""
        return self.result.selection


@dataclass(frozen=True, eq=False, repr=False)
class Fit(_Reported):
    """A fitted contact model.

    Attributes
    ----------
    trials : tuple of Trial
    refused : tuple of Refusal
        Recordings that could not be fitted, with the reason.
    setting : object
        Options and priors that it was fitted with.
    fitted : FittedSpecimen
        Optimum, noise and everything derived from them.
    """

    trials: tuple[Trial, ...]
    refused: tuple[Refusal, ...]
    setting: _Setting
    fitted: FittedSpecimen

    @property
    def result(self) -> SpecimenFit:  # type: ignore[override]
        """The specimen as identification.json has it."""
        return self.fitted.fit

    def __getitem__(self, name: str) -> Estimate:
        return self.parameter(name)

    def __repr__(self) -> str:
        return f"<Fit of {self.result.specimen}: {self.result.model.name or self.result.model.key}>"

    def fix(self, **values: float) -> Fit:
        """Fit again with parameters held at values.

        ``values``: by name or symbol, in the unit of the parameter: ``fit.fix(tau=0.02)``.  Raises
        UsageError: a value is none that the parameter can have, or follows from others, as a viscosity does.
        """
        priors = self.setting.priors
        linear, shapes = dict(priors.linear), dict(priors.shapes)
        law = self.fitted.identified.law
        positive = {one.name for one in law.model().parameters} - set(law.linear_names)
        names = [f"relaxation_time_s{branch_suffix(j)}" for j in range(law.counts[0])]
        times = dict(zip_longest(names, priors.relaxation_time_s[: len(names)]))
        for name, value in values.items():
            one = self.parameter(name)
            if one.name in law.linear_names:
                linear[one.name] = (float(value), FIXED * max(abs(float(value)), FIXED))
            elif one.name in positive and value > 0.0:
                (times if one.name in times else shapes)[one.name] = SpreadPrior(float(value), FIXED)
            else:
                why = "has to be positive" if one.name in positive else "follows from other parameters"
                told = ", ".join(law.model().parameter_names)
                refuse(f"{name} = {value:g}: {one.name} {why}; {told} can be fixed")
        options = self.setting.options.of_law(self.result.model)
        return fit(
            self.trials, specimen=self.result.specimen, options=options, segment=self.setting.segment,
            priors=replace(priors, linear=linear, shapes=shapes, relaxation_time_s=tuple(times.values())),
        )  # fmt: skip

    def force(self, trial: Trial) -> FloatArray:
        """Force of the load channel that the model predicts at every sample of a recording, (n,) [N].

        Signs and zero are the recording's.  A recording of the fit has its own gain and contact; of another
        the tissue is predicted as it is, with nothing free.  Before contact it is the reading in air, and
        after the part that can be predicted (the tool turned back) NaN.  Raises InputError: there is no
        contact in the recording.
        """
        for place, one in enumerate(self.trials):
            if one is trial:
                return _along(self, trial, self.fitted.handles[place], place)
        return _along(self, trial, _handle_of(trial, self.setting), None)

    def residual(self, trial: Trial) -> FloatArray:
        """Measured minus predicted force, (n,) [N]; NaN where nothing is predicted."""
        return np.asarray(trial.force_N - self.force(trial))

    def plot(self, trial: Trial | None = None) -> Plot:
        """Measured and predicted force of a recording against time; by default of the largest force."""
        trial = trial or max(self.trials, key=lambda one: float(np.ptp(one.force_N)))
        predicted = self.force(trial)
        shown = np.isfinite(predicted)
        axes = self.result.axes
        curves = [
            ("measured", trial.time_s, trial.force_N, MEASURED),
            ("model", trial.time_s[shown], predicted[shown], MODEL),
        ]
        return Plot(drawing(curves, up=f"[{axes.force}]", words=f"Force of {trial.name} and model"))

    def sample(self, draws: int = 2_000, seed: int = 0) -> Sampled:
        """Draw from the posterior, from this optimum on.

        ``draws``: effective draws to go on for.  Raises NotIdentifiedError: nothing could be drawn, with the
        reason; UsageError: there is no such number of draws, or no such seed.
        """
        if draws < 1 or seed < 0:
            refuse(f"draws = {draws}, seed = {seed}: give 1 draw or more, and a seed of 0 or more")
        asked = PosteriorOptions(draws=draws, seed=seed)
        found = with_draws(self.fitted, asked, self.setting.priors, instrument=self.setting.machine)
        if found.posterior is None:
            said = [one.values["reason"] for one in found.flags if one.code == "sampler_not_converged"]
            msg = f"{found.specimen}: no posterior could be sampled: {'; '.join(map(str, said))}"
            raise NotIdentifiedError(msg)
        return Sampled(self, replace(found, axes=self.result.axes), asked)


def _along(fit: Fit, trial: Trial, handle: LogHandle, place: int | None) -> FloatArray:
    """Predicted force of the load channel, with the gain and contact of a log of the fit or of none."""
    found = fit.fitted.identified
    point = found.optimum.point
    if place is None:
        point = replace(point, own=np.zeros_like(point.own[:1]))
    _, log = handle.fitted()
    out = at_samples(trial, handle, log, force_along(found, handle, log, place or 0, point))
    contact = handle.segmentation.contact
    assert contact is not None  # noqa: S101 -- without one there is no handle
    return np.asarray(handle.segmentation.force_sign * out + contact.baseline_N)


def _handle_of(trial: Trial, setting: _Setting) -> LogHandle:
    """A recording that the fit does not have, segmented as those that it has."""
    found = collect(
        [trial], setting.segment, TrialCache(None), lambda *_: None, unloading=setting.options.unloading
    )
    if not found.groups:
        raise found.left_out[0].as_error()
    return found.groups[trial.specimen][0]


@dataclass(frozen=True, slots=True, eq=False)
class Marginal:
    """Posterior of one parameter."""

    name: str
    unit: str
    values: FloatArray  # (n,), draws with the machine open (statistical ones of normalised recordings)
    #: Printed numbers: ``ci95`` of the specimen, ``ci95_total`` with the machine, ``prediction95``.
    uncertainty: ParameterUncertainty

    @property
    def median(self) -> float:
        """Median of the draws."""
        return float(np.median(self.values))

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Interval that holds this share of the draws; at 0.95 the printed total interval.

        Raises ValueError: the level is no share.
        """
        if not 0.0 < level < 1.0:
            raise ValueError(f"an interval holds a share between 0 and 1 of the draws, got {level:g}")
        if level == 0.95:
            return self.uncertainty.ci95_total or self.uncertainty.ci95
        low, high = np.quantile(self.values, (0.5 - 0.5 * level, 0.5 + 0.5 * level))
        return float(low), float(high)


@dataclass(frozen=True, eq=False, repr=False)
class Sampled(_Reported):
    """A fit with its posterior: values are medians, intervals have been read off the draws.

    Attributes
    ----------
    fit : Fit
    result : SpecimenFit
    options : PosteriorOptions
    """

    fit: Fit
    result: SpecimenFit
    options: PosteriorOptions

    def __repr__(self) -> str:
        return f"<Sampled {self.result.specimen}: {len(self._draws)} draws kept>"

    @property
    def _posterior(self) -> Posterior:
        posterior = self.result.posterior
        assert posterior is not None  # noqa: S101 -- it was checked when this was made
        return posterior

    @cached_property
    def _draws(self) -> FloatArray:
        total = self._posterior.draws_total
        return self._posterior.draws if total is None else total

    def __getitem__(self, name: str) -> Marginal:
        one = self.parameter(name)
        values = reported_draws(self.fit.fitted.tissue.model, self._draws)[one.name]
        return Marginal(one.name, one.unit, values, self._posterior.parameters[one.name])

    def band(self, trial: Trial, level: float = 0.95) -> tuple[FloatArray, FloatArray]:
        """Band that holds the whole force of a push at another site with this probability, (n,) [N] each.

        The push is along the recording's path, at whatever speed, in its signs and its zero; NaN where
        nothing is predicted.  How much sites differ is told by the logs of the fit; with one log it is
        unknown, and left out.  Raises InputError: there is no contact in the recording.
        """
        handle = _handle_of(trial, self.fit.setting)
        _, log = handle.fitted()
        half = at_samples(trial, handle, log, half_width(self.fit.fitted, handle, log, self._draws, level))
        middle = _along(self.fit, trial, handle, None)
        return middle - half, middle + half

    def to_arviz(self) -> Any:
        """The draws as arviz knows them.

        Raises UsageError: arviz, of the extra ``tissueid[arviz]``, is not installed.
        """
        return self._posterior.to_arviz()


@dataclass(frozen=True, slots=True)
class Plot:
    """A drawing that a notebook shows, and that can be saved."""

    svg: str

    def _repr_html_(self) -> str:
        return self.svg

    def save(self, path: str | Path) -> Path:
        """Write it as an SVG file."""
        write_file(Path(path), svg_file(self.svg))
        return Path(path)


class Bundle:
    """A fit as a file that a device renders and a colleague reads.

    Parameters
    ----------
    fit : Fit
    sampled : Sampled, optional
        Its posterior; values and draws are then taken from it.
    """

    def __init__(self, fit: Fit, sampled: Sampled | None = None) -> None:
        posterior = None if sampled is None else sampled.options
        found = fit.result if sampled is None else sampled.result
        self.content: BundleContent = bundle_from_fit(found, provenance=fit.setting.provenance(posterior))

    def _repr_html_(self) -> str:
        return html_of(self.content)

    def save(self, path: str | Path) -> Path:
        """Write the bundle, whole or not at all; a law that is a function has to be known where it is read.

        Raises BundleError: it could not be loaded again.
        """
        write_bundle(self.content, path)
        return Path(path)


def render(
    bundle: str | Path,
    *,
    device: str = "sim",
    script: str | None = None,
    seconds: float | None = None,
    log: str | Path | None = None,
    agreed: bool = False,
) -> Outcome:
    """Render a bundle on a device; without one, a script runs as fast as it can be computed.

    Parameters
    ----------
    bundle : str or Path
    device : str
        ``sim``, or another of ``tissueid devices list``.
    script : str, optional
        Strokes of the simulated grip (docs/render.md); by default one push of the identified depth.
    seconds : float, optional
        Length of a session that a hand leads.
    log : str or Path, optional
        Record the session to this HDF5 file.
    agreed : bool
        The person who holds a device with motors was told and agreed.

    Returns
    -------
    Outcome
        Summary, log, and how the session ended.

    Raises
    ------
    BundleError, UsageError, DeviceError
        Before anything moved, with the way out.
    """
    from tissueid.rendering.options import RenderOptions
    from tissueid.rendering.plan import plan_session
    from tissueid.rendering.recorder import Recorder
    from tissueid.rendering.session import Session

    if not Path(bundle).is_file():
        raise BundleError(f"{bundle}: there is no such bundle; Bundle(fit).save({str(bundle)!r}) writes one")
    load_bundle(bundle)
    virtual = device == "sim" and seconds is None
    plan = plan_session(
        RenderOptions(bundle=Path(bundle), device=device, script=script, seconds=seconds, virtual=virtual)
    )
    if plan.capabilities.hardware and not agreed:
        refuse(f"{device} has motors: tell the person who holds it, then say agreed=True")
    return Session(plan, recorder=None if log is None else Recorder(Path(log), plan.head)).run()
