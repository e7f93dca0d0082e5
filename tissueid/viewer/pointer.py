"""The pointer: mouse or keys on a page lead the hand that holds the simulated device.

The hand is a spring and a damper around the point it is led to, so that the force on it shows: it is pushed
back from the tissue by force over stiffness.  Letting go leads it back above the tissue.  The shared memory
that this writes exists for a simulated device alone; where there is none, every pointer is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.haptics.shared_hand import SharedHand

#: How far beyond the workspace a hand may be led [m]: 6 N of a 300 N/m hand.
BEYOND_M = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class HandPointer:
    """Leads a hand within its workspace."""

    hand: SharedHand
    rest_m: NDArray[np.float64]  # (3,), where it goes when it is let go [m]
    #: (3,): corners of the workspace [m].
    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]  # (3,)

    def lead(self, position_m: Sequence[float] | None) -> None:
        """Lead the hand to a point, or back to its rest.

        ``position_m``: device frame [m]; cut to the workspace and 20 mm around it.
        """
        wanted = self.rest_m if position_m is None else np.asarray(position_m, dtype=np.float64)
        self.hand.point_at(np.clip(wanted, self.low_m - BEYOND_M, self.high_m + BEYOND_M).tolist())
