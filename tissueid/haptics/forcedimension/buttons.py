"""Buttons of the Force Dimension SDK in the order of the Falcon's own wire (compiled).

One bit means one button in every limit, log and message: 0x01 plus, 0x02 forward, 0x04 centre, 0x08 minus, so
that the dead-man button is the centre whoever drives the device.  The SDK numbers them centre 0, left 1,
up 2, right 3; from documentation, no unit has confirmed it.
"""

from __future__ import annotations

from tissueid.compiled import tick_part

#: Bits of the SDK's mask.
_CENTRE, _LEFT, _UP, _RIGHT = 0x1, 0x2, 0x4, 0x8


@tick_part
def wire_buttons(mask: int) -> int:
    """Bits of :data:`tissueid.haptics.falcon.packets.BUTTON_NAMES` for a mask of the SDK."""
    return (
        (0x04 if mask & _CENTRE else 0)
        | (0x08 if mask & _LEFT else 0)
        | (0x02 if mask & _UP else 0)
        | (0x01 if mask & _RIGHT else 0)
    )
