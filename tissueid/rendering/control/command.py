"""One tick of the controller: from what was measured to the control force (compiled)."""

from __future__ import annotations

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel
from tissueid.rendering.control.block import PERIOD, TOUCHED_BY_DEVICE
from tissueid.rendering.control.drive import advance_tool, environment_force, tool_acceleration
from tissueid.rendering.control.law import control_force, reference, robust_term, saturate, sigma_at
from tissueid.rendering.control.plant import regress


@tick_kernel
def command(
    block: FloatArray,
    law: FloatArray,
    state: FloatArray,
    time: float,
    device: tuple[FloatArray, FloatArray],
    hand: FloatArray,
    touched: float,
    tool: tuple[FloatArray, FloatArray, FloatArray],
    wanted: tuple[FloatArray, FloatArray, FloatArray],
    robust: FloatArray,
    estimates: FloatArray,
    Y: FloatArray,
    u: FloatArray,
) -> float:
    """Step the virtual tool through the coming period and say the force that is held through it.

    Held until the next tick, the command aims at where the tool will be then.

    ``block``, ``law``, ``state``: of the loop, of the tissue, and what the tissue remembers (**updated**);
    ``time``: since the start [s]; sigma falls with it; ``device`` (n,): measured position [m] and velocity
    [m/s]; ``hand`` (n,): measured force of the hand on the device [N]; ``touched``: force of the environment
    after the last period [N]; ``tool`` (n,): position, velocity, acceleration of the virtual tool;
    **updated**; ``wanted`` (n,): **Written**: vr, ar, rho; ``robust`` (n,): **Written**: u_r [N];
    ``estimates`` (p,); ``Y`` (n, p): **Written**: the regressor, for
    :func:`tissueid.rendering.control.law.adapt`; ``u`` (n,): **Written**: control force [N], saturated.
    Returns force of the environment at the end of the period [N].
    """
    if block[TOUCHED_BY_DEVICE] > 0.0:
        touched = environment_force(block, law, state, device[0], block[PERIOD])
    touched = advance_tool(block, law, state, tool, hand, touched)
    tool_acceleration(block, tool[1], hand, touched, tool[2])
    reference(block, device, tool, wanted)
    robust_term(block, wanted[2], sigma_at(block, time), robust)
    regress(block, device[0], device[1], wanted[0], wanted[1], Y)
    control_force(block, Y, estimates, wanted[2], robust, hand, u)
    saturate(block, u)
    return float(touched)
