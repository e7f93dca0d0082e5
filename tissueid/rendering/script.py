"""A script of a session: strokes of the simulated grip, and switches between tissues at their ends.

::

    indent 4 mm at 250 mm/min; hold 1 s; retract at 250 mm/min; switch; indent 4 mm at 250 mm/min

Strokes are those of :mod:`tissueid.haptics.hand`, in tissue units.  ``switch`` goes to the next tissue; the
servo takes it when nothing is touched, so it must stand where the tool is out of the tissue.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import UsageError
from tissueid.haptics.hand import Hand, Stroke, parse_script, scripted_hand

SWITCH = "switch"
#: Start-up ramp of the simulated device under a script [s]: the shortest that the guard knows.
RAMP_S = 0.5
#: Rest above the tissue before the first stroke [s]: homing (0.05 s) and the ramp are over by then.
REST_S = 0.6
#: Time after the last stroke that is still recorded [s].
TAIL_S = 0.05


@dataclass(frozen=True, slots=True)
class Script:
    """Strokes of a scripted session."""

    text: str  # as the user wrote it
    strokes_text: str  # the strokes alone, for the hand
    strokes: tuple[Stroke, ...]
    switches_s: tuple[float, ...]  # when to go to the next tissue, from the start of the device's time [s]
    #: From the start of the device's time to the end of the last stroke, and a moment more [s].
    duration_s: float

    def hand(self, *, motion_scale: float, surface_m: FloatArray, inward: FloatArray) -> Hand:
        """The machine that carries the simulated grip through the strokes."""
        return scripted_hand(
            self.strokes_text,
            motion_scale=motion_scale,
            surface_m=surface_m,
            inward=inward,
            rest_s=REST_S,
        )


def read_script(text: str) -> Script:
    """Read a script.

    Raises UsageError: a part is no stroke, leads nowhere, or switches inside the tissue.
    """
    parts = [" ".join(part.split()) for part in text.split(";") if part.strip()]
    stroke_texts = [part for part in parts if part != SWITCH]
    strokes = parse_script("; ".join(stroke_texts))
    ends = REST_S + np.cumsum([stroke.duration_s for stroke in strokes])
    switches, done = [], 0
    for part in parts:
        if part != SWITCH:
            done += 1
            continue
        if done and strokes[done - 1].depth_mm >= 0.0:
            msg = (
                f"script: 'switch' after {stroke_texts[done - 1]!r} would change the tissue under the tool; "
                "retract first"
            )
            raise UsageError(msg)
        switches.append(float(ends[done - 1]) if done else 0.5 * REST_S)
    return Script(text, "; ".join(stroke_texts), strokes, tuple(switches), float(ends[-1]) + TAIL_S)
