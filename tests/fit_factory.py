"""A specimen's fit made by hand: closed-form ramp and hold with noise, no fitting code involved.

The static force is a cubic, one branch has constant stiffness K and relaxation time tau.  In a ramp of
speed v the branch carries K v tau (1 - exp(-t / tau)), in the hold it decays from there.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tissueid.documents.identification import Exit, Relaxation
from tissueid.flags import Flag
from tissueid.pipeline import IdentifyOptions
from tissueid.result import (
    Curve,
    Estimate,
    Identification,
    ModelChoice,
    Nrmsd,
    Refusal,
    ResidualSummary,
    SpecimenFit,
    TrialFit,
)
from tissueid.store.files import IDENTIFICATION, json_bytes
from tissueid.store.merged import merge_files, specimen_bytes
from tissueid.store.outputs import OutputSet
from tissueid.study.specimen_job import result_of

STATIC = (4.0, 0.8, 0.05)
STIFFNESS, TAU_S = 6.0, 1.5
THETA = np.array([*STATIC, STIFFNESS, TAU_S])
THETA_NAMES = (
    *("static_1_N_per_mm", "static_2_N_per_mm2", "static_3_N_per_mm3"),
    *("stiffness_0_N_per_mm", "relaxation_time_s"),
)


def ramp_hold_curve(speed: float, depth: float, *, hold_s: float, samples: int, seed: int) -> Curve:
    """A noisy ramp and hold beside its closed form."""
    ramp_s = depth / speed
    time = np.linspace(0.0, ramp_s + hold_s, samples)
    x = np.minimum(speed * time, depth)
    steady = STIFFNESS * speed * TAU_S
    loading = -steady * np.expm1(-np.minimum(time, ramp_s) / TAU_S)
    branch = loading * np.exp(-np.maximum(time - ramp_s, 0.0) / TAU_S)
    model = STATIC[0] * x + STATIC[1] * x**2 + STATIC[2] * x**3 + branch
    force = model + np.random.default_rng(seed).normal(0.0, 0.3, samples)
    return Curve(time, x, force, model, fitted=x > 0.2)


def residual_of(curve: Curve, *, start_s: float, ramp_s: float) -> ResidualSummary:
    """Summary of a curve's residual as fits keep it: bins of 0.1 N, lags 1, 2, 5, two blocks of the hold."""
    fitted = curve.fitted
    residual = (curve.force_N - curve.model_N)[fitted]
    edges = np.linspace(-1.5, 1.5, 31)
    centred = residual - residual.mean()
    lags = np.array([1, 2, 5])
    since = curve.time_s[fitted] - ramp_s
    blocks = [(since >= low) & (since < high) for low, high in ((0.1, 1.0), (1.0, 10.0))]
    return ResidualSummary(
        start_s=start_s,
        step_s=float(curve.time_s[1] - curve.time_s[0]),
        edges_N=edges,
        counts=np.bincount(np.searchsorted(edges, residual, side="right"), minlength=32),
        lags=lags,
        correlation=np.array([centred[k:] @ centred[:-k] / (centred @ centred) for k in lags.tolist()]),
        hold_since_s=np.array([0.1 * 10**0.5, 10**0.5]),
        hold_mean_N=np.array([residual[inside].mean() if inside.any() else 0.0 for inside in blocks]),
        hold_count=np.array([max(int(inside.sum()), 1) for inside in blocks]),
    )


def trial_fit(path: str, curve: Curve, *, sheet: str | None = None, speed: float) -> TrialFit:
    residual = curve.force_N - curve.model_N
    rmse = float(np.sqrt(np.mean(residual**2)))
    span = float(np.ptp(curve.force_N))
    return TrialFit(
        path=path,
        sheet=sheet,
        nrmsd=Nrmsd(rmse / span, rmse / float(curve.force_N.mean()), rmse),
        max_residual_fraction=float(np.abs(residual).max()) / span,
        residual_acf1=float(np.corrcoef(residual[:-1], residual[1:])[0, 1]),
        gain=1.01,
        contact_offset_mm=-0.02,
        speed_mm_s=speed,
        depth_mm=float(curve.depth_mm.max()),
        n_samples=curve.time_s.size,
        curve=curve,
        residual=residual_of(curve, start_s=2.5, ramp_s=curve.depth_mm.max() / speed),
        flags=(Flag("zero_dt", "2 samples carry the time of their neighbour", {"count": 2}),),
    )


def specimen_fit(specimen="kidney 3", *, trials=3, samples=800, identified=True, sheet=None, seed=0):
    """A fit whose numbers are the truth above."""
    speeds = [0.5, 2.0, 4.0]
    fits = []
    for i in range(trials):
        speed = speeds[i % 3]
        curve = ramp_hold_curve(speed, 6.0, hold_s=12.0, samples=samples, seed=seed + i)
        fits.append(trial_fit(f"lab data/{specimen}/run_{i + 1}.csv", curve, sheet=sheet, speed=speed))
    sd = np.array([0.05, 0.02, 0.003, 0.08, 0.03])
    units = ("N/mm", "N/mm^2", "N/mm^3", "N/mm", "s")
    rows = zip(THETA_NAMES, ("a1", "a2", "a3", "b0", "tau"), units, THETA.tolist(), sd.tolist(), strict=True)
    parameters = [
        Estimate(name, symbol, unit, value, error, identified=True, detail={"estimate": value})
        for name, symbol, unit, value, error in rows
    ]
    if not identified:
        open_end = {"estimate": 1.5, "width_ln": 4.0}
        parameters[-1] = replace(parameters[-1], value=None, stderr=None, identified=False, detail=open_end)
    parameters.append(Estimate("viscosity_N_s_per_mm", "eta", "N s/mm", 9.0, 0.11, identified=True))
    row = Relaxation(
        path=fits[0].path,
        sheet=sheet,
        window_s=(12.0, 24.0),
        peak_force_N=68.1,
        tau_single_s=1.48,
        nrmsd_single=0.021,
        tau_double_s=(0.9, 1.7),
        tau_triple_s=(),
        flags=(Flag("one_tau_inadequate", "one relaxation time leaves 3 times the noise", {"ratio": 3.0}),),
    )
    unknown = Flag("not_identified", "the relaxation time is known to a factor of 50 only", {"factor": 50.0})
    return SpecimenFit(
        specimen=specimen,
        model=ModelChoice("kelvin-voigt", 1, 3, 0, "partial"),
        parameters=tuple(parameters),
        theta_names=THETA_NAMES,
        theta=THETA.copy(),
        covariance=np.diag(sd**2),
        depth_mm=6.0,
        speeds_mm_s=(0.5, 4.0),
        tip_radius_mm=3.0,
        sigma_N=0.3,
        n_samples=trials * samples,
        nrmsd=fits[0].nrmsd,
        trials=tuple(fits),
        relaxation=(row,),
        optimisers={"method": "LM and VP", "agree": True, "relative_difference": 1e-12},
        selection=(
            {"branches": 1, "stiffness_degree": 0, "score": -0.4, "stderr": 0.9, "chosen": True},
            {"branches": 2, "stiffness_degree": 0, "score": 0.0, "stderr": 0.0, "chosen": False},
        ),
        flags=(
            *[unknown] * (not identified),
            Flag("compliance_unknown", "frame compliance is taken as none"),
        ),
    )


def identification(fits: Sequence[SpecimenFit], *, refused: bool = False) -> Identification:
    inputs = [
        {
            "path": trial.path,
            "sheet": trial.sheet,
            "sha256": f"{i:064x}",
            "recipe": "bluehill",
            "columns": {"time": "Time", "displacement": "Extension", "force": "Load"},
            "specimen": fit.specimen,
            "n_samples": trial.n_samples,
        }
        for fit in fits
        for i, trial in enumerate(fit.trials)
    ]
    prose = "the file is prose; export raw data"
    notes = Refusal("lab data/<b>notes</b>.csv", None, "not_an_export", prose, 3, 1)
    return Identification(
        specimens=tuple(fits),
        refused=(notes,) * refused,
        exit=Exit(7, ("1 input was refused",)) if refused else Exit(0, ()),
        provenance={
            "tissueid": "0.1.0",
            "options": {"branches": "auto", "seed": 0, "required": ["static"]},
            "inputs": inputs,
        },
    )


def write_results(run: OutputSet, found: Identification) -> None:
    """Write the files of a finished fit into an output set, as `tissueid fit` does."""
    run.write(IDENTIFICATION, json_bytes(found.as_json()))
    files, inputs = {}, {}
    for number, fit in enumerate(found.specimens):
        result = result_of(replace(found, specimens=(fit,)), shown=fit.specimen, options=IdentifyOptions())
        files[fit.specimen] = run.path(f"{number}.h5")
        inputs[fit.specimen] = result.bundle.provenance["inputs"]
        files[fit.specimen].write_bytes(specimen_bytes(result))
    merge_files(run, files, inputs, found.provenance)
    for path in files.values():
        path.unlink()
