"""Table 2: the whole protocol, synthesised with the printed branch and identified again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tissueid.reproduce.items import Item, within_interval
from tissueid.reproduce.published import PUBLISHED, SADEGHNEJAD, Ledger, Published
from tissueid.reproduce.readings import Readings
from tissueid.reproduce.recordings import TAILS_99, Effort, fitted, interval_of, read_back, total_draws
from tissueid.reproduce.tissue import read_branch
from tissueid.result import SpecimenFit
from tissueid.synth.protocols import recipe

#: White noise of the load cell [N].
SIGMA_N = 1.0


def identified_table(
    readings: Readings, effort: Effort, numbers: Mapping[str, Published] = PUBLISHED
) -> list[Item]:
    """Rows of Table 2: 18 ramps at six speeds and 4 holds, through reader, segmentation and fit."""
    effort.progress("Table 2: 18 ramps and 4 holds")
    ledger = Ledger(SADEGHNEJAD, numbers)
    branch = read_branch(ledger, readings)
    protocol = replace(
        recipe("paper-a-22"),
        branches=(branch,),
        rate_Hz=ledger.assume(f"sampled at {effort.rate_Hz:g} Hz", effort.rate_Hz),
        sigma_N=ledger.assume(f"white noise of {SIGMA_N:g} N", SIGMA_N),
        static=ledger.assume("static curve 20 x - 1.2 x^2 + 0.35 x^3 N", recipe("paper-a-22").static),
    )
    (fit,) = fitted(read_back(protocol, seed=effort.seed), effort, stiffness_degree=len(branch.stiffness) - 1)
    stiffness = (
        f"stiffness_{len(branch.stiffness) - 1}_{'N_per_mm' if len(branch.stiffness) == 1 else 'N_per_mm2'}"
    )
    tau, interval = fit.parameter("relaxation_time_s").value, interval_of(fit, "relaxation_time_s")
    if readings.relaxation == "rate":
        tau = None if tau is None else 1.0 / tau
        interval = None if interval is None else (1.0 / interval[1], 1.0 / interval[0])
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
            Ledger(SADEGHNEJAD, numbers).item(
                f"table-2/{name}",
                None,
                words=f"Coefficient {name} of the static force",
                unit=unit,
                where="Table 2",
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
        product = draws[:, names["stiffness_0_N_per_mm"]] * draws[:, names["relaxation_time_s"]]
        low, high = np.quantile(product, TAILS_99)
        interval = float(low), float(high)
    return ledger.item(
        "table-2/viscosity",
        fit.parameter("viscosity_N_s_per_mm").value,
        interval=interval,
        words="Viscosity K tau",
        unit="N s/mm",
        where="Table 2",
        note="known ten times better than K and tau by themselves",
    )
