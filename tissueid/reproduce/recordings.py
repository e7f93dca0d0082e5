"""Protocols simulated, exported, read and fitted: Table 2, and Fig. 5 with its NRMSD.

Paper A prints 4.23 to 10.95 % and neither by what it divides nor whether the model was fitted to the same
recordings.  Here 17 specimens scatter by an assumed 15 %, and each is predicted from the 16 others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from tempfile import TemporaryDirectory

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.reproduction import Figure, Item, Trace
from tissueid.errors import NotIdentifiedError
from tissueid.inference.posterior import PosteriorOptions
from tissueid.inference.specimen import FitOptions
from tissueid.ingest import read_trials
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.pipeline import IdentifyOptions, identify
from tissueid.reproduce.published import (
    SADEGHNEJAD,
    Kind,
    Ledger,
    Readings,
    Said,
    overlaps,
    points,
    within_interval,
)
from tissueid.reproduce.speeds import read_branch
from tissueid.result import Curve, SpecimenFit
from tissueid.synth.dataset import write_set
from tissueid.synth.recipe import Branch, Recipe, recipe
from tissueid.trial import Trial
from tissueid.uncertainty import Posterior

#: Tails of a 99 % interval.
TAILS_99 = (0.005, 0.995)


@dataclass(frozen=True, slots=True)
class Effort:
    """Effort of a recomputation."""

    rate_Hz: float = 1000.0  # sampling rate of simulated recordings
    draws: int = 10_000  # effective draws of a posterior; 0 leaves posteriors out
    specimens: int = 17  # simulated specimens of the cohort
    seed: int = 20_261_122
    progress: Callable[[str], None] = lambda _message: None  # ``progress(message)``


def read_back(recipe: Recipe, *, seed: int) -> list[Trial]:
    """Simulate a recipe, write its exports to a folder of their own, and read them."""
    with TemporaryDirectory(prefix="tissueid-reproduce-") as folder:
        write_set(recipe, folder, seed=seed)
        return read_trials(folder)


def fitted(
    trials: Sequence[Trial], effort: Effort, *, stiffness_degree: int, static: str = "shared"
) -> tuple[SpecimenFit, ...]:
    """Fit every specimen among trials of white noise, the model's order known."""
    options = IdentifyOptions(
        fit=FitOptions(branches=1, stiffness_degree=stiffness_degree, static=static, noise="white"),
        posterior=PosteriorOptions(draws=effort.draws, seed=effort.seed) if effort.draws else None,
        seed=effort.seed,
    )
    found = identify(trials, options=options)
    if found.exit.code in (3, 7):
        msg = f"a simulated recording was refused: {'; '.join(found.exit.reasons)}"
        raise NotIdentifiedError(msg)
    return found.specimens


def interval_of(fit: SpecimenFit, name: str) -> tuple[float, float] | None:
    """99 % interval of a parameter, the machine as unknown as it was to the fit; ``None`` without draws."""
    if fit.posterior is None or name not in fit.posterior.theta_names:
        return None
    return _central_99(total_draws(fit.posterior)[:, fit.posterior.theta_names.index(name)])


def _central_99(draws: FloatArray) -> tuple[float, float]:
    low, high = np.quantile(draws, TAILS_99)
    return float(low), float(high)


def relaxation_of(fit: SpecimenFit, readings: Readings) -> tuple[float | None, tuple[float, float] | None]:
    """Relaxation as the reading has it, a time or a rate, and its 99 % interval."""
    tau, interval = fit.parameter("relaxation_time_s").value, interval_of(fit, "relaxation_time_s")
    if readings.relaxation == "time":
        return tau, interval
    return None if tau is None else 1.0 / tau, interval and (1.0 / interval[1], 1.0 / interval[0])


def total_draws(posterior: Posterior) -> FloatArray:
    """Draws of theta with the machine open, or held where it can't be."""
    return posterior.draws if posterior.draws_total is None else posterior.draws_total


#: White noise of the load cell [N].
SIGMA_N = 1.0


def _assumed(ledger: Ledger, branch: Branch, rate_Hz: float) -> Recipe:
    """18 ramps and 4 holds of a tissue with a branch."""
    plain = recipe("paper-a-22")
    return replace(
        plain,
        branches=(branch,),
        rate_Hz=ledger.assume(f"sampled at {rate_Hz:g} Hz", rate_Hz),
        sigma_N=ledger.assume(f"white noise of {SIGMA_N:g} N", SIGMA_N),
        static=ledger.assume("static curve 20 x - 1.2 x^2 + 0.35 x^3 N", plain.static),
    )


def identified_table(readings: Readings, effort: Effort) -> list[Item]:
    """Rows of Table 2: 18 ramps at six speeds and 4 holds, through reader, segmentation and fit."""
    effort.progress("Table 2: 18 ramps and 4 holds")
    ledger = Ledger(SADEGHNEJAD, "Table 2")
    branch = read_branch(ledger, readings)
    protocol = _assumed(ledger, branch, effort.rate_Hz)
    (fit,) = fitted(read_back(protocol, seed=effort.seed), effort, stiffness_degree=len(branch.stiffness) - 1)
    stiffness = (
        f"stiffness_{len(branch.stiffness) - 1}_{'N_per_mm' if len(branch.stiffness) == 1 else 'N_per_mm2'}"
    )
    tau, interval = relaxation_of(fit, readings)
    return [
        ledger.item(
            "table-2/stiffness",
            fit.parameter(stiffness).value,
            interval=interval_of(fit, stiffness),
            judge=within_interval(),
        ),
        ledger.item("table-2/tau", tau, interval=interval, judge=within_interval()),
        _viscosity(ledger, fit),
        *(
            Ledger(SADEGHNEJAD, "Table 2").item(
                f"table-2/{name}",
                None,
                said=Said(f"Coefficient {name} of the static force", unit),
                note="the cell did not survive in the text that this was made from",
            )
            for name, unit in (("a1", "N/mm"), ("a2", "N/mm2"), ("a3", "N/mm3"))
        ),
    ]


def _viscosity(ledger: Ledger, fit: SpecimenFit) -> Item:
    """K tau, which the ramps know far better than its factors."""
    interval = None
    names = {} if fit.posterior is None else {n: k for k, n in enumerate(fit.posterior.theta_names)}
    if fit.posterior is not None and "stiffness_1_N_per_mm2" not in names:
        draws = total_draws(fit.posterior)
        interval = _central_99(draws[:, names["stiffness_0_N_per_mm"]] * draws[:, names["relaxation_time_s"]])
    return ledger.item(
        "table-2/viscosity",
        fit.parameter("viscosity_N_s_per_mm").value,
        interval=interval,
        said=Said("Viscosity K tau", "N s/mm"),
        note="known ten times better than K and tau by themselves",
    )


#: Coefficient of variation of a whole specimen, of neighbouring tests, and of contact [mm].
CV_SPECIMEN, CV_REPEAT, CONTACT_SD_MM = 0.15, 0.05, 0.05
#: A cohort is recorded at a tenth of the machine's rate, which the prediction of ramps does not feel.
RATE_HZ = 100.0
#: Share of specimens between the ends that are quoted.
CENTRAL = (0.16, 0.84)
#: Places, from soft to stiff, of the specimens that are drawn, and points of each.
SHOWN = (0.1, 0.5, 0.9)
DRAWN = 120


def specimen_scatter(readings: Readings, effort: Effort) -> tuple[list[Item], Figure]:
    """NRMSD of held-out specimens by range and by mean, and three of them drawn."""
    effort.progress(f"Fig. 5: {effort.specimens} specimens")
    ledger = Ledger(SADEGHNEJAD, "Fig. 5")
    branch = read_branch(ledger, readings)
    protocol = _assumed(ledger, branch, RATE_HZ)
    cohort = replace(
        protocol,
        logs=tuple(replace(log, repeats=1) for log in protocol.logs if log.name.startswith("ramp")),
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
            said=Said(f"NRMSD of a held-out specimen by {name}, central 68 %"),
            judge=overlaps(),
            note=f"median {100.0 * float(np.median(column)):.3g} %; scatter between specimens gives it, not "
            "the model's form",
        )
        for name, column in zip(("range", "mean"), errors.T, strict=True)
    ]
    return items, _figure(fits)


def held_out_errors(fits: Sequence[SpecimenFit]) -> FloatArray:
    """Error of predicting each specimen by the mean force of the others on its own path."""
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
        depth = points(curve.depth_mm[use])
        predicted = _predicted(fits, k, curve)[use]
        name = fits[k].specimen
        traces.append(Trace(name, depth, points(curve.force_N[use], 3), "points", None))
        traces.append(Trace(f"{name}, predicted", depth, points(predicted, 3), "dash", None))
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
        x_log=False,
        drawing=None,
        traces=tuple(traces),
    )
