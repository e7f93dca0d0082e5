"""Control law, adaptation and Lyapunov function (compiled): equations (16) to (22), (I-1) and (I-4).

Of the equations of Sadeghnejad et al. the text kept the numbers alone: what stands here is a set that
satisfies each of their sentences (docs/control.md says which parts are readings)::

    (17) vr  = ve + L (xe - x)                  ar = ae + L (ve - v)
    (16) rho = vr - v
    (20) u   = Y th + Kr rho + ur               variant B: less the measured force of the hand
    (21) ur  = delta^2 rho / (delta |rho| + sigma(t))
    (22) sigma(t) = sigma0 exp(-g t), not below a floor in a sampled loop
         th' = Gamma Y' rho, kept within bounds
"""

from __future__ import annotations

import math

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_kernel
from tissueid.rendering.control.block import (
    ADAPTATION_SIGN,
    DAMPING,
    DISTURBANCE_BOUND,
    PERIOD,
    PROJECTION,
    REFERENCE_RATE,
    SATURATION,
    SIGMA_FLOOR,
    SIGMA_RATE,
    SIGMA_START,
    TOUCHED_BY_DEVICE,
    VARIANT,
    VARIANT_B,
)
from tissueid.rendering.control.drive import advance_tool, environment_force, tool_acceleration
from tissueid.rendering.control.plant import damping_form, inertia, regress


@tick_kernel
def reference(
    block: FloatArray,
    device: tuple[FloatArray, FloatArray],
    tool: tuple[FloatArray, FloatArray, FloatArray],
    wanted: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Reference of the device: equations (16) and (17).

    ``block`` (BLOCK_SIZE,); ``device`` (n,): position [m] and velocity [m/s]; ``tool`` (n,): position,
    velocity and acceleration of the virtual tool; ``wanted`` (n,): **Written**: vr [m/s], ar [m/s^2], rho
    [m/s].
    """
    x, v = device
    xe, ve, ae = tool
    vr, ar, rho = wanted
    rate = block[REFERENCE_RATE]
    for i in range(x.size):
        vr[i] = ve[i] + rate * (xe[i] - x[i])
        ar[i] = ae[i] + rate * (ve[i] - v[i])
        rho[i] = vr[i] - v[i]


@tick_kernel
def sigma_at(block: FloatArray, time: float) -> float:
    """sigma(t) of equation (22) [N m/s]."""
    return float(max(block[SIGMA_START] * math.exp(-block[SIGMA_RATE] * time), block[SIGMA_FLOOR]))


@tick_kernel
def robust_term(block: FloatArray, rho: FloatArray, sigma: float, out: FloatArray) -> None:
    """Write u_r [N], equation (21): smooth, along rho, of length delta at most."""
    length = 0.0
    for i in range(rho.size):
        length += rho[i] * rho[i]
    delta = block[DISTURBANCE_BOUND]
    below = delta * math.sqrt(length) + sigma
    for i in range(rho.size):
        out[i] = delta * delta * rho[i] / below if below > 0.0 else 0.0


@tick_kernel
def control_force(
    block: FloatArray,
    Y: FloatArray,
    estimates: FloatArray,
    rho: FloatArray,
    robust: FloatArray,
    hand: FloatArray,
    out: FloatArray,
) -> None:
    """Write u [N], equation (20), before saturation; ``hand`` is the measured force of the hand."""
    for i in range(out.size):
        total = block[DAMPING] * rho[i] + robust[i]
        for k in range(estimates.size):
            total += Y[i, k] * estimates[k]
        if block[VARIANT] == VARIANT_B:
            total -= hand[i]
        out[i] = total


@tick_kernel
def saturate(block: FloatArray, u: FloatArray) -> None:
    """Shorten a force to what the device can give, in its direction."""
    length = 0.0
    for i in range(u.size):
        length += u[i] * u[i]
    length = math.sqrt(length)
    if length > block[SATURATION]:
        for i in range(u.size):
            u[i] *= block[SATURATION] / length


@tick_kernel
def adapt(
    block: FloatArray,
    Y: FloatArray,
    rho: FloatArray,
    gains: FloatArray,
    bounds: FloatArray,
    h: float,
    estimates: FloatArray,
) -> None:
    """Move the estimates on by ``h`` seconds; with projection they stay within their bounds.

    ``block``, ``Y``, ``rho``: as above; ``gains`` (p,): diagonal of Gamma; ``bounds`` (2, p): smallest and
    largest value of each parameter; ``estimates`` (p,): **Updated.**.
    """
    for k in range(estimates.size):
        slope = 0.0
        for i in range(rho.size):
            slope += Y[i, k] * rho[i]
        estimates[k] += h * block[ADAPTATION_SIGN] * gains[k] * slope
        if block[PROJECTION] > 0.0:
            estimates[k] = min(max(estimates[k], bounds[0, k]), bounds[1, k])


@tick_kernel
def not_covered(block: FloatArray, push: FloatArray, disturbed: FloatArray, out: FloatArray) -> None:
    """Write what the estimates don't cover [N]: F* - d in variant A, -d in B."""
    for i in range(out.size):
        out[i] = -disturbed[i] if block[VARIANT] == VARIANT_B else push[i] - disturbed[i]


@tick_kernel
def lyapunov(
    block: FloatArray,
    x: FloatArray,
    terms: tuple[FloatArray, FloatArray, FloatArray],
    truth: FloatArray,
    estimates: FloatArray,
    gains: FloatArray,
    room: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[float, float]:
    """V of (I-1) and the right side of (I-4), which V' equals where nothing is sampled, late or saturated.

    ``block``, ``x``, ``estimates``, ``gains``: as above; ``terms`` (n,): rho, robust, and what is unknown of
    :func:`not_covered` [N]; ``truth`` (p,): true parameters of what is estimated; ``room`` (2, n) and (n, p)
    and (n, n): to work in, and written.  Returns ``V, rate``: [J] where the gains are in their units; [W].
    """
    rho, robust, unknown = terms
    spare, Y, M = room
    inertia(block, truth, x, spare, Y, M)
    V = 0.0
    rate = -damping_form(truth, rho)
    for i in range(rho.size):
        for j in range(rho.size):
            V += 0.5 * rho[i] * M[i, j] * rho[j]
        rate -= rho[i] * (block[DAMPING] * rho[i] + unknown[i] + robust[i])
    for k in range(truth.size):
        if gains[k] > 0.0:
            V += 0.5 * (truth[k] - estimates[k]) ** 2 / gains[k]
    return V, rate


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
