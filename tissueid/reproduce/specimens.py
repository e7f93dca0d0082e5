"""Fig. 5 and the NRMSD: how well the model of other specimens predicts one that it has not seen.

Paper A prints 4.23 to 10.95 % and neither by what it divides nor whether the model was fitted to the same
recordings.  Here 17 specimens scatter by an assumed 15 %, and each is predicted from the 16 others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.reproduce.items import Figure, Item, Kind, Trace, overlaps
from tissueid.reproduce.published import PUBLISHED, SADEGHNEJAD, Ledger, Published
from tissueid.reproduce.readings import Readings
from tissueid.reproduce.recordings import Effort, fitted, read_back
from tissueid.reproduce.tissue import read_branch
from tissueid.result import Curve, SpecimenFit
from tissueid.synth.protocols import recipe

#: Coefficient of variation of a whole specimen, of neighbouring tests, and of contact [mm].
CV_SPECIMEN, CV_REPEAT, CONTACT_SD_MM = 0.15, 0.05, 0.05
#: A cohort is recorded at a tenth of the machine's rate, which the prediction of ramps does not feel.
RATE_HZ = 100.0
SIGMA_N = 1.0
#: Share of specimens between the ends that are quoted.
CENTRAL = (0.16, 0.84)
#: Places, from soft to stiff, of the specimens that are drawn, and points of each.
SHOWN = (0.1, 0.5, 0.9)
DRAWN = 120


def specimen_scatter(
    readings: Readings, effort: Effort, numbers: Mapping[str, Published] = PUBLISHED
) -> tuple[list[Item], Figure]:
    """NRMSD of held-out specimens by range and by mean, and three of them drawn."""
    effort.progress(f"Fig. 5: {effort.specimens} specimens")
    ledger = Ledger(SADEGHNEJAD, numbers)
    branch = read_branch(ledger, readings)
    ramps = tuple(log for log in recipe("paper-a-22").logs if log.name.startswith("ramp"))
    cohort = replace(
        recipe("paper-a-22"),
        logs=tuple(replace(log, repeats=1) for log in ramps),
        branches=(branch,),
        rate_Hz=ledger.assume(f"sampled at {RATE_HZ:g} Hz", RATE_HZ),
        sigma_N=ledger.assume(f"white noise of {SIGMA_N:g} N", SIGMA_N),
        static=ledger.assume("static curve 20 x - 1.2 x^2 + 0.35 x^3 N", recipe("paper-a-22").static),
        specimens=effort.specimens,
        cv_specimen=ledger.assume("specimens scatter by 15 %", CV_SPECIMEN),
        cv_both=ledger.assume("tests of a specimen scatter by 5 %", CV_REPEAT),
        contact_offset_sd_mm=ledger.assume("contact is known to 0.05 mm", CONTACT_SD_MM),
    )
    quick = replace(effort, draws=0)
    fits = fitted(
        read_back(cohort, seed=effort.seed),
        quick,
        stiffness_degree=len(branch.stiffness) - 1,
        static="partial",
    )
    errors = held_out_errors(fits)
    items = [
        ledger.item(
            f"figure-5/nrmsd-by-{name}",
            tuple(100.0 * float(q) for q in np.quantile(column, CENTRAL)),  # type: ignore[arg-type]
            against="figure-5/nrmsd",
            words=f"NRMSD of a held-out specimen by {name}, central 68 %",
            judge=overlaps(),
            note=f"median {100.0 * float(np.median(column)):.3g} %; scatter between specimens gives it, not "
            "the model's form",
        )
        for name, column in zip(("range", "mean"), errors.T, strict=True)
    ]
    return items, _figure(fits)


def held_out_errors(fits: Sequence[SpecimenFit]) -> FloatArray:
    """Error of predicting each specimen by the mean force of the others on its own path.

    Returns (specimens, 2), mean NRMSD of its recordings by range and by mean force, fractions.
    """
    errors = []
    for k, fit in enumerate(fits):
        rows = []
        for trial in fit.trials:
            use = trial.curve.fitted & (trial.curve.depth_mm <= min(one.depth_mm for one in fits))
            force = trial.curve.force_N[use]
            rmsd = float(np.sqrt(np.mean((_predicted(fits, k, trial.curve)[use] - force) ** 2)))
            rows.append((rmsd / float(np.ptp(force)), rmsd / float(force.mean())))
        errors.append(np.mean(rows, axis=0))
    return np.array(errors)


def _predicted(fits: Sequence[SpecimenFit], left_out: int, curve: Curve) -> FloatArray:
    """Mean over the other specimens of the force of each on a path [N]."""
    path = ContactPath(curve.time_s, np.maximum(curve.depth_mm, 0.0))
    forces = [
        kelvin_voigt(
            branches=fit.model.branches, stiffness_degree=fit.model.stiffness_degree, depth_mm=fit.depth_mm
        ).force(fit.theta, path)
        for k, fit in enumerate(fits)
        if k != left_out
    ]
    return np.asarray(np.mean(forces, axis=0))


def _figure(fits: Sequence[SpecimenFit]) -> Figure:
    """Three specimens, soft to stiff, at their fastest ramp, and what the others predict."""
    curves = [fit.trials[-1].curve for fit in fits]
    order = sorted((float(curve.force_N.max()), k) for k, curve in enumerate(curves))
    traces: list[Trace] = []
    for place in SHOWN:
        k = order[int(place * (len(order) - 1))][1]
        curve = curves[k]
        use = np.flatnonzero(curve.fitted)
        use = use[np.linspace(0, use.size - 1, min(use.size, DRAWN)).astype(int)]
        depth = tuple(round(float(x), 4) for x in curve.depth_mm[use])
        predicted = _predicted(fits, k, curve)[use]
        name = fits[k].specimen
        traces.append(Trace(name, depth, tuple(round(float(f), 3) for f in curve.force_N[use]), "points"))
        traces.append(
            Trace(f"{name}, predicted", depth, tuple(round(float(f), 3) for f in predicted), "dash")
        )
    return Figure(
        "figure-5",
        SADEGHNEJAD,
        "Fig. 5",
        "The model beside three specimens it has not seen",
        Kind.ASSUMED,
        "Simulated specimens that scatter by 15 %; each dashed line is the mean of the other specimens. The "
        "paper's own recordings are not published.",
        "Displacement [mm]",
        "Force [N]",
        tuple(traces),
    )
