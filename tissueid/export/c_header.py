"""A tissue as one C header: its constants, and the step that a servo takes, equal to ours bit for bit.

C99, no heap, no dependency but math.h.  Constants are written as hexadecimal floats, so that nothing is lost
on the way; compile without fast-math and without contraction (gcc: -ffp-contract=off) to keep every bit.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from tissueid.errors import UsageError
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.store.bundle_content import Bundle

__all__ = ["c_header"]

_HEAD = """\
/* One identified soft tissue, for real-time use.  Not a medical device.
 *
 * specimen   {specimen}
 * claimed    depth 0 to {depth:g} mm, speed {slow:g} to {fast:g} mm/s{tip}
 * beyond     F_s goes on with its end slope, K with its own, neither falls below what it is there
 * written    by tissueid {version}
 *
 *   {name}_tissue t = {{0}};                       at rest, surface at 0 mm
 *   double force_N = {name}_step(&t, depth_mm, dt_s);
 *
 * depth_mm is the tool below the resting surface at the end of the step, negative in air; dt_s the measured
 * step.  The force is never negative: without adhesion a tool is not pulled.  Exact for motion that is linear
 * within a step, whatever its length.
 */
#ifndef {guard}
#define {guard}

#include <math.h>

#define {upper}_BRANCHES {branches}
#define {upper}_DEPTH_MM {depth_hex}
"""

_BODY = """\

typedef struct {
    double surface_mm;
    double state_mm[@UPPER@_STATES];
} @NAME@_tissue;

/* value and slope of a polynomial, continued with its end slope (not below 0) beyond the claimed depth */
static inline double @NAME@_continued(const double *c, int size, double x, double *slope)
{
    const double inside = fmin(fmax(x, 0.0), @UPPER@_DEPTH_MM);
    double value = 0.0, s = 0.0;
    for (int k = size - 1; k >= 0; k--) {
        s = s * inside + value;
        value = value * inside + c[k];
    }
    if (x > @UPPER@_DEPTH_MM) {
        s = fmax(s, 0.0);
        value += s * (x - @UPPER@_DEPTH_MM);
    }
    *slope = s;
    return value;
}

/* force on a surface that moves linearly to y in this step, and its slope by y */
static inline double @NAME@_following(const double *decayed, const double *gain, double from, double y,
                                      double *slope)
{
    double force = @NAME@_continued(@NAME@_static, 4, y, slope);
    const double moved = y - from;
    for (int j = 0; j < @UPPER@_BRANCHES; j++) {
        const double elongation = decayed[j] + gain[j] * moved;
        double dk;
        const double k = @NAME@_continued(@NAME@_stiffness[j], 3, y, &dk);
        force += k * elongation;
        *slope += dk * elongation + k * gain[j];
    }
    return force;
}

/* where a free surface ends this step, deeper than the tool: bracketed Newton */
static inline double @NAME@_free_surface(const double *decayed, const double *gain, double from,
                                         double target)
{
    double low = target, high = fmax(from, target), width = 1e-3 * @UPPER@_DEPTH_MM, slope;
    double force = @NAME@_following(decayed, gain, from, high, &slope);
    for (int i = 0; i < @ITERATIONS@ && force < 0.0; i++) {
        low = high;
        high += width;
        width *= 2.0;
        force = @NAME@_following(decayed, gain, from, high, &slope);
    }
    double y = high;
    const double resolution = 1e-14 * @UPPER@_DEPTH_MM;
    for (int i = 0; i < @ITERATIONS@; i++) {
        if (fabs(force) <= resolution * slope || high - low <= resolution)
            break;
        if (force > 0.0)
            high = y;
        else
            low = y;
        double candidate = slope > 0.0 ? y - force / slope : low;
        if (!(low < candidate && candidate < high))
            candidate = 0.5 * (low + high);
        y = candidate;
        force = @NAME@_following(decayed, gain, from, y, &slope);
    }
    return y;
}

/* advance by dt_s seconds; returns the force on the tool [N] */
static inline double @NAME@_step(@NAME@_tissue *t, double depth_mm, double dt_s)
{
    const double target = fmax(depth_mm, 0.0);
    double decayed[@UPPER@_STATES] = {0}, gain[@UPPER@_STATES] = {0}, slope;
    for (int j = 0; j < @UPPER@_BRANCHES; j++) {
        const double ratio = dt_s / @NAME@_tau_s[j];
        const double kept = ratio <= 0.0 ? 1.0 : exp(-ratio);
        decayed[j] = kept * t->state_mm[j];
        gain[j] = ratio <= 0.0 ? 1.0 : -expm1(-ratio) / ratio;
    }
    const double force = @NAME@_following(decayed, gain, t->surface_mm, target, &slope);
    double y = target;
    if (force < 0.0 && @UPPER@_BRANCHES > 0)
        y = @NAME@_free_surface(decayed, gain, t->surface_mm, target);
    const double moved = y - t->surface_mm;
    for (int j = 0; j < @UPPER@_BRANCHES; j++) {
        const double elongation = decayed[j] + gain[j] * moved;
        t->state_mm[j] = fabs(elongation) >= @FLUSH@ ? elongation : 0.0;
    }
    t->surface_mm = y;
    return depth_mm >= 0.0 ? fmax(force, 0.0) : 0.0;
}

#endif
"""


def c_header(bundle: Bundle) -> bytes:
    """Write the header of a tissue.

    Parameters
    ----------
    bundle : Bundle
        Of a modified Kelvin-Voigt tissue in mm and N.

    Returns
    -------
    bytes
        ASCII.

    Raises
    ------
    UsageError
        The tissue has another law.
    BundleError
        It was normalised.
    """
    from tissueid import __version__
    from tissueid.model.kernels import FLUSH_MM, MAX_DETACHED_ITERATIONS

    bundle.require_renderable()
    model = bundle.contact_model()
    if not isinstance(model, KelvinVoigt):
        msg = f"{bundle.specimen}: a C header needs a Kelvin-Voigt tissue, this one is {bundle.model.key!r}"
        raise UsageError(msg)
    static, stiffness, tau = model.split(bundle.theta)
    name = _identifier(bundle.specimen)
    upper = name.upper()
    padded = np.zeros((max(model.branches, 1), 3))
    padded[: model.branches, : stiffness.shape[1]] = stiffness
    rows = ", ".join(_listed(row) for row in padded)
    tip = "" if bundle.tip_radius_mm is None else f", tip radius {bundle.tip_radius_mm:g} mm"
    head = _HEAD.format(
        specimen=_plain(bundle.specimen),
        depth=bundle.depth_mm,
        slow=bundle.speeds_mm_s[0],
        fast=bundle.speeds_mm_s[1],
        tip=tip,
        version=__version__,
        name=name,
        upper=upper,
        guard=f"{upper}_H",
        branches=model.branches,
        depth_hex=float(bundle.depth_mm).hex(),
    )
    constants = [
        f"#define {upper}_STATES {max(model.branches, 1)}",
        "",
        "/* F_s by powers of x from x^0 [N/mm^k]; K_j likewise [N/mm^(k+1)]; relaxation times [s] */",
        f"static const double {name}_static[4] = {_listed([0.0, *static])};",
        f"static const double {name}_stiffness[{upper}_STATES][3] = {{{rows}}};",
        f"static const double {name}_tau_s[{upper}_STATES] = {_listed(tau if model.branches else [1.0])};",
    ]
    body = _BODY
    for mark, text in (
        ("@NAME@", name),
        ("@UPPER@", upper),
        ("@ITERATIONS@", str(MAX_DETACHED_ITERATIONS)),
        ("@FLUSH@", repr(FLUSH_MM)),
    ):
        body = body.replace(mark, text)
    return (head + "\n".join(constants) + "\n" + body).encode("ascii")


def _listed(values: Iterable[float]) -> str:
    return "{" + ", ".join(float(value).hex() for value in values) + "}"


def _identifier(specimen: str) -> str:
    """A name for C made of that of a specimen."""
    name = re.sub(r"[^0-9A-Za-z]+", "_", specimen).strip("_").lower() or "tissue"
    return name if name[0].isalpha() else f"tissue_{name}"


def _plain(text: str) -> str:
    """Text that can neither end nor begin a comment, in ASCII."""
    plain = text.encode("ascii", "replace").decode("ascii")
    return " ".join(plain.replace("*/", "* /").replace("/*", "/ *").split())
