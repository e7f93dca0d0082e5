"""From recordings to a study of their ruptures: each is segmented up to its end, each specimen's law fitted.

The fit is that of ``tissueid fit`` without a sampler; what its law does not know comes from its covariance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tissueid.decided import as_decided
from tissueid.documents.rupture import LeftOut
from tissueid.errors import InputError, NotIdentifiedError, UsageError
from tissueid.manifest import Study
from tissueid.model.grammar import KELVIN_VOIGT, ModelNameError, candidates, rebuilt
from tissueid.pipeline import IdentifyOptions, identify, with_model
from tissueid.result import Identification, Refusal
from tissueid.rupture.failures import Failure, LoadedTest, SpecimenLaw, failures_of, loaded_test
from tissueid.rupture.study import RuptureStudy, rupture_study
from tissueid.rupture_law import DEFAULT_WEIGHT
from tissueid.segment import SegmentOptions, segment
from tissueid.trial import Source, Trial

#: Fewest samples below the contact point that show how a measure grows.
FEWEST_BELOW = 3

_Key = tuple[str, str | None]


@dataclass(frozen=True, slots=True, eq=False)
class RuptureRun:
    """A study of ruptures and the fit behind it."""

    study: RuptureStudy
    identification: Identification
    left_out: tuple[LeftOut, ...]  # fitted recordings that no measure could be taken of


@dataclass(slots=True)
class _Ends:
    """Tests up to their end, picked up while the recordings pass by."""

    study: Study | None
    options: SegmentOptions
    found: dict[_Key, LoadedTest] = field(default_factory=dict)

    def watch(self, trials: Iterable[Trial]) -> Iterator[Trial]:
        """The same trials; what each did to the tissue is kept."""
        for raw in trials:
            self._add(raw)
            yield raw

    def _add(self, raw: Trial) -> None:
        trial, options, excluded = as_decided(raw, self.options, self.study)
        if excluded is not None:
            return
        try:
            test = loaded_test(trial, segment(trial, options=options))
        except (ArithmeticError, np.linalg.LinAlgError):
            return  # the fit refuses the same recording, and says why
        if test is not None:
            self.found[raw.source.path, raw.source.sheet] = test


def run_rupture(
    trials: Iterable[Trial],
    *,
    study: Study | None = None,
    options: IdentifyOptions | None = None,
    reload: Callable[[Source], Trial] | None = None,
    refused: Sequence[Refusal] = (),
    asked: str = "none",
    weight: float = DEFAULT_WEIGHT,
    progress: Callable[[str, int, int], None] | None = None,
) -> RuptureRun:
    """Study the ruptures of a cohort.

    ``trials``: all tests, also those that did not rupture; ``options``: of the fit; a posterior is not
    sampled; ``reload``, ``refused``, ``progress``: as of :func:`tissueid.pipeline.identify`; ``asked``: one
    of :data:`~tissueid.rupture.study.ASKED`; ``weight``: w of the weighted force.  Raises InputError: nothing
    could be fitted; the first refusal says why; NotIdentifiedError: too few tests ruptured, or the recordings
    are normalised.
    """
    fit_options = replace(with_model(options or IdentifyOptions(), study), posterior=None, required=())
    _refuse_yardstick(fit_options.fit.model or KELVIN_VOIGT)
    ends = _Ends(study, fit_options.segment)
    identification = identify(
        ends.watch(trials),
        study=study,
        options=fit_options,
        reload=reload,
        refused=refused,
        progress=progress,
    )
    if not identification.specimens:
        raise _nothing_fitted(identification)
    failures: list[Failure] = []
    left_out: list[LeftOut] = []
    for fit in identification.specimens:
        if fit.axes.normalised:
            msg = f"{fit.specimen}: the recordings are normalised, and a rupture is measured in mm and N"
            raise NotIdentifiedError(msg)
        model = rebuilt(fit.model, fit.depth_mm)
        law = SpecimenLaw(fit.specimen, model, np.asarray(fit.theta), np.asarray(fit.covariance))
        tests = []
        for trial in fit.trials:
            test = ends.found.get((trial.path, trial.sheet))
            why = None if test is None else _why_not(test, trial.contact_offset_mm)
            if test is None or why is not None:
                left_out.append(LeftOut(trial.path, trial.sheet, why or "no loading to a depth was found"))
            else:
                tests.append((test, trial.contact_offset_mm))
        failures += failures_of(law, tests, weight=weight)
    found = rupture_study(failures, weight=weight, asked=asked)
    return RuptureRun(found, identification, tuple(left_out))


def _refuse_yardstick(name: str) -> None:
    """Refuse a model without parameters, and a name that is none."""
    try:
        laws = candidates(name)
    except ModelNameError as error:
        raise UsageError(str(error)) from None
    if laws.paper is None and all(one.mark for one in laws.laws):
        msg = f"{name} has no parameters to quote: name a law of `tissueid models` for a rupture"
        raise UsageError(msg)


def _nothing_fitted(identification: Identification) -> InputError:
    """The first refusal, with how many there are."""
    if not identification.refused:
        return InputError(code="no_recordings", message="no recording was found", path="")
    first, more = identification.refused[0], len(identification.refused) - 1
    message = f"{first.message}; {more} more were refused" if more else first.message
    return InputError(code=first.code, message=message, path=first.path, sheet=first.sheet, line=first.line)


def _why_not(test: LoadedTest, offset_mm: float) -> str | None:
    """Why nothing can be measured at the end of a test."""
    if (test.depth_mm > offset_mm).sum() < FEWEST_BELOW:
        return f"fewer than {FEWEST_BELOW} of its samples lie below the contact point"
    if not (test.force_N > 0.0 and test.work_N_mm > 0.0):
        return "no force or work is left at its end"
    return None
