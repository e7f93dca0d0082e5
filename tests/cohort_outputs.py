"""An output folder of several specimens with posteriors, made by hand: no recording, no fitting."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from fit_factory import THETA, identification, specimen_fit, write_results
from posterior_factory import sampled

from tissueid.documents.identification import Calibration, StatedSpecimen
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.result import SpecimenFit
from tissueid.store.outputs import OutputSet

#: Relative uncertainty of F_s, K and tau in each specimen's own posterior.
OWN = np.array([0.01, 0.01, 0.01, 0.03, 0.03])


def cohort_fits(count: int) -> tuple[SpecimenFit, ...]:
    """Fits whose posteriors scatter around specimens that differ by a factor in force and in stiffness."""
    rng = np.random.default_rng(0)
    model = kelvin_voigt(1, 0, 6.0)
    fits = []
    for i in range(count):
        force, stiffness = np.exp(0.12 * rng.standard_normal(2))
        scale = np.array([force, force, force, stiffness, 1.0])
        draws = THETA * scale * np.exp(OWN * rng.standard_normal((600, 5)))
        assert all(model.is_passive(one) for one in draws)
        fit = sampled(specimen_fit(f"head {i + 1}", samples=60, seed=3 * i), seed=i)
        gains = np.exp(0.03 * rng.standard_normal(len(fit.trials)))
        trials = tuple(
            replace(trial, gain=float(gain), speed_mm_s=2.0)
            for trial, gain in zip(fit.trials, gains, strict=True)
        )
        own = replace(fit.posterior, draws=draws, draws_total=draws, log_prior=np.zeros(len(draws)))
        fits.append(replace(fit, posterior=own, trials=trials))
    return tuple(fits)


def cohort_folder(folder: Path, count: int, *, study: bool = True) -> Path:
    """The output folder of such fits, with a study that states sex and donor."""
    fits = cohort_fits(count)
    known = identification(fits)
    if study:
        known = replace(known, study=study_of(fits))
    with OutputSet(folder) as run:
        write_results(run, known)
        run.commit()
    return folder


def study_of(fits: tuple[SpecimenFit, ...]) -> dict[str, object]:
    row = dict.fromkeys(StatedSpecimen.__struct_fields__)
    trial = dict.fromkeys(("site", "protocol", "rest_s", "because", "notes"))
    return {
        "path": "study.toml",
        "sha256": "",
        "study": {},
        "tip": {},
        "calibration": dict.fromkeys(Calibration.__struct_fields__),
        "priors": {},
        "specimens": [
            row | {"specimen": fit.specimen, "sex": "fm"[i % 2], "donor": f"d{i // 2}"}
            for i, fit in enumerate(fits)
        ],
        "trials": [
            {"path": one.path, "sheet": one.sheet, "specimen": fit.specimen, **trial}
            | {"run": k + 1, "listed": True, "overridden": []}
            for fit in fits
            for k, one in enumerate(fit.trials)
        ],
        "exclusions": [],
    }
