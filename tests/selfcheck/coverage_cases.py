"""The cases whose coverage is looked at: one specimen's protocol at 100 Hz, its noise, scatter and defects.

Truths are drawn from the proper priors that the fit is given; the order of the model is fixed.  Contact
points are found in the recordings, behind a second in air; where the noise there is correlated, which
segmentation does not know of, they are stated with their standard deviation.  Seeds are part of the cases.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.selfcheck.protocol import Centre, of_program
from tissueid.selfcheck.tissue import TissueCheck, tissue_check
from tissueid.selfcheck.truth import Widths
from tissueid.synth.recipe import Hold, Log, Move

CONTACT_SD_MM = 0.01
#: Two ramps at different speeds and depths, two fast ones, three holds: 7 logs, some 2,100 samples at 100 Hz.
LOGS = (
    Log("ramp-60", (Move(4.0, 60.0),)),
    Log("ramp-250", (Move(8.0, 250.0),)),
    Log("ramp-500", (Move(8.0, 500.0),), repeats=2),
    Log("hold-4", (Move(4.0, 250.0), Hold(3.0))),
    Log("hold-8", (Move(8.0, 250.0), Hold(3.0)), repeats=2),
)
ONE_BRANCH = (20.0, -1.2, 0.35, 63.62, 10.0, 0.021)
TWO_BRANCHES = (20.0, -1.2, 0.35, 63.62, 0.021, 15.0, 0.6)


@dataclass(frozen=True)
class Case:
    """One noise, scatter or instrument.

    ``phi`` is the correlation over one sample, ``gain_sd`` the scale of the prior of the standard deviation
    of the logs' ln gains.  A frame of ``frame_N_per_mm`` stands behind every recording, unknown to the fit.
    """

    name: str
    seed: int
    phi: float = 0.0
    gain_sd: float = 0.02
    defects: bool = False
    theta: tuple[float, ...] = ONE_BRANCH
    branches: int = 1
    degree: int = 1
    frame_N_per_mm: float | None = None

    def check(self) -> TissueCheck:
        protocol = of_program(LOGS, rate_Hz=100.0, contact_sd_mm=CONTACT_SD_MM, words="seven logs")
        model = kelvin_voigt(branches=self.branches, stiffness_degree=self.degree, depth_mm=protocol.depth_mm)
        centre = Centre(
            model=model,
            theta=np.array(self.theta),
            sigma_N=1.0,
            phi=self.phi,
            white_share=0.0,
            pooling="partial",
        )
        widths = Widths(gain_sd=self.gain_sd, arctanh_phi=0.3)
        check = tissue_check(protocol, centre, widths=widths, defects=self.defects)
        check = replace(check, contact_stated=self.phi > 0.0)
        if self.frame_N_per_mm is None:
            return check
        return replace(check, instrument={"frame_compliance_mm_per_N": 1.0 / self.frame_N_per_mm})


CASES = (
    Case("white", seed=20261101, gain_sd=0.005),
    Case("AR(1) 0.9", seed=20261102, phi=0.9),
    Case("AR(1) 0.99", seed=20261103, phi=0.99),
    Case("gain 2 %", seed=20261104, gain_sd=0.02),
    Case("specimen CV 15 %", seed=20261105, gain_sd=0.15),
    Case("calibration defects, total interval", seed=20261161, defects=True),
    Case("two branches", seed=20261107, theta=TWO_BRANCHES, branches=2, degree=0),
)
FRAMES = (
    Case("unknown frame of 200 N/mm", seed=20261162, defects=True, frame_N_per_mm=200.0),
    Case("unknown frame of 1,000 N/mm", seed=20261163, defects=True, frame_N_per_mm=1000.0),
)
