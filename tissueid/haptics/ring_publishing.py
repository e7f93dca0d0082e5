"""Signal of the servo's tick that a record of the ring is whole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import tick_part
from tissueid.haptics.atomic import store_release
from tissueid.haptics.ring import PUBLISHED_AT


@tick_part
def publish(head: NDArray[np.int64], count: int) -> None:
    """Say that ``count`` records are whole.

    ``head`` (8,): :attr:`tissueid.haptics.ring.Ring.head`; ``count``: records written since the ring was
    made.
    """
    store_release(head[PUBLISHED_AT : PUBLISHED_AT + 1], count)
