"""What passivity and pooling cost on a real workbook of ramp-and-hold tests (one test a sheet).

    python benchmarks/workbook.py WORKBOOK.xlsx

Prints the median trial NRMSD (by range) of the default fit, each sheet its own specimen; of the same models
without the passivity constraint (same branches and degree, relaxation times searched anew); and of all
sheets taken as one specimen.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time

import numpy as np
from scipy.optimize import minimize

from tissueid.inference.window import fitted_log
from tissueid.ingest import ReadOptions, read_trials
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.states import branch_states
from tissueid.pipeline import identify
from tissueid.result import SpecimenFit
from tissueid.segment import segment
from tissueid.trial import Trial


def unconstrained(trial: Trial, fit: SpecimenFit) -> float:
    """NRMSD of the same model with coefficients of any sign."""
    log = fitted_log(trial, segment(trial))
    path = ContactPath(log.data.time_s, log.data.depth_mm)
    used = log.data.include
    force = log.data.force_N[used]
    model = kelvin_voigt(fit.model.branches, fit.model.stiffness_degree, log.depth_mm)

    def residual(log_tau: np.ndarray) -> float:
        columns = list(model.static.basis(path.depth_mm))
        for state in branch_states(path.time_s, path.depth_mm, np.exp(np.clip(log_tau, -6.0, 6.0))):
            columns += [state * path.depth_mm**k for k in range(model.stiffness_law.powers)]
        basis = np.column_stack(columns)[used]
        scale = np.abs(basis).max(axis=0)
        weights = np.linalg.lstsq(basis / scale, force, rcond=1e-12)[0]
        return float(np.sqrt(np.mean((force - basis / scale @ weights) ** 2)))

    start = np.log([p.detail["estimate"] for p in fit.parameters if p.name.startswith("relaxation_time")])
    best = min(
        minimize(residual, start + shift, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-9}).fun
        for shift in (0.0, 0.3, -0.3)
    )
    return best / float(np.ptp(force))


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("workbook")
    path = parser.parse_args().workbook
    trials = read_trials(path)
    start = time.perf_counter()
    found = identify(trials)
    seconds = time.perf_counter() - start
    passive = [fit.trials[0].nrmsd.range for fit in found.specimens]
    free = [unconstrained(trial, fit) for trial, fit in zip(trials, found.specimens, strict=True)]
    pooled = identify(read_trials(path, ReadOptions(specimen_by="(.*)::"))).specimens
    together = [trial.nrmsd.range for fit in pooled for trial in fit.trials]
    holds = [row for fit in found.specimens for row in fit.relaxation]
    inadequate = sum(any(flag.code == "one_tau_inadequate" for flag in row.flags) for row in holds)
    print(f"sheets fitted {len(passive)}, holds {len(holds)}, one tau inadequate in {inadequate}")
    print(f"median NRMSD, each its own specimen, passive: {100 * statistics.median(passive):.2f} %")
    print(f"  largest {100 * max(passive):.2f} %, {seconds / len(passive):.2f} s a sheet")
    print(f"median NRMSD, same models, unconstrained:     {100 * statistics.median(free):.2f} %")
    print(
        f"median NRMSD, {len(pooled)} specimen of all sheets:     {100 * statistics.median(together):.2f} %"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
