"""A tissue as one C header: its constants, and the step that a servo takes, equal to ours bit for bit.

C99, no heap, no dependency but math.h.  Constants are written as hexadecimal floats, so that nothing is lost
on the way; compile without fast-math and without contraction (gcc: -ffp-contract=off) to keep every bit.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.export.prony import carried_law
from tissueid.model.kernels import OWN_SIZE
from tissueid.model.servo_law import OWN, STATIC, ServoLaw
from tissueid.store.bundle import Bundle

_HEADER = """\
/* One identified soft tissue, for real-time use.  Not a medical device.
 *
 * specimen   @SPECIMEN@
 * claimed    @CLAIMED@
 * beyond     F_s goes on with its end slope, K with its own, neither falls below what it is there
 * law        @LAW@
 * constants  theta, the bundle's one coherent vector; a report prints medians of the posterior
 * written    by tissueid @VERSION@
 *
 *   @NAME@_tissue t = {0};                       at rest, surface at 0 mm
 *   double force_N = @NAME@_step(&t, depth_mm, dt_s);
 *
 * depth_mm is the tool below the resting surface at the end of the step, negative in air; dt_s the measured
 * step.  The force is never negative: without adhesion a tool is not pulled.  Exact for motion that is linear
 * within a step and in contact throughout; a step in which contact begins or ends should be short.
 */
#ifndef @UPPER@_H
#define @UPPER@_H

#include <math.h>

#define @UPPER@_BRANCHES @BRANCHES@
#define @UPPER@_DEPTH_MM @DEPTH@
#define @UPPER@_STATES @STATES@
#define @UPPER@_PIECES @PIECES@

/* F_s by powers of x from x^0 [N/mm^k]; K_j likewise, @UNIT@; relaxation times [s] */
static const double @NAME@_static[@UPPER@_PIECES][4] = @STATIC@;
static const double @NAME@_stiffness[@UPPER@_STATES][3] = @STIFFNESS@;
static const double @NAME@_tau_s[@UPPER@_STATES] = @TAU@;
@OWN@
/* state and followed: of every exponential, in mm where it follows the depth, else in N */
typedef struct {
    double surface_mm;
    double state[@UPPER@_STATES];
    double followed[@UPPER@_STATES];
} @NAME@_tissue;

/* value and slope of a polynomial, continued with its end slope (not below 0) beyond the claimed depth */
static inline double @NAME@_continued(const double *c, int size, double x, double depth, double *slope)
{
    const double inside = fmin(fmax(x, 0.0), depth);
    double value = 0.0, s = 0.0;
    for (int k = size - 1; k >= 0; k--) {
        s = s * inside + value;
        value = value * inside + c[k];
    }
    if (x > depth) {
        s = fmax(s, 0.0);
        value += s * (x - depth);
    }
    *slope = s;
    return value;
}

@STATIC_FORCE@
@FOLLOWS@
/* force on a surface that moves linearly to y in this step, and its slope by y */
static inline double @NAME@_following(const double *decayed, const double *gain, const double *from, double y,
                                      double *slope)
{
    double rise, rate;
    const double at_rest = @NAME@_static_force(y, &rise);
    double force = at_rest;
    *slope = rise;
    for (int j = 0; j < @UPPER@_BRANCHES; j++) {
        const double now = @NAME@_follows(j, y, at_rest, rise, &rate);
        const double elongation = decayed[j] + gain[j] * (now - from[j]);
        double dk;
        const double k = @NAME@_continued(@NAME@_stiffness[j], 3, y, @UPPER@_DEPTH_MM, &dk);
        force += k * elongation;
        *slope += dk * elongation + k * gain[j] * rate;
    }
    return force;
}

/* where a free surface ends this step, deeper than the tool: bracketed Newton */
static inline double @NAME@_free_surface(const double *decayed, const double *gain, const double *from,
                                         double surface, double target)
{
    double low = target, high = fmax(surface, target), width = 1e-3 * @UPPER@_DEPTH_MM, slope;
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
    double decayed[@UPPER@_STATES] = {0}, gain[@UPPER@_STATES] = {0}, slope, rise, rate;
    for (int j = 0; j < @UPPER@_BRANCHES; j++) {
        const double ratio = dt_s / @NAME@_tau_s[j];
        const double kept = ratio <= 0.0 ? 1.0 : exp(-ratio);
        decayed[j] = kept * t->state[j];
        gain[j] = ratio <= 0.0 ? 1.0 : -expm1(-ratio) / ratio;
    }
    const double force = @NAME@_following(decayed, gain, t->followed, target, &slope);
    double y = target;
    if (force < 0.0 && @UPPER@_BRANCHES > 0)
        y = @NAME@_free_surface(decayed, gain, t->followed, t->surface_mm, target);
    const double at_rest = @NAME@_static_force(y, &rise);
    for (int j = 0; j < @UPPER@_BRANCHES; j++) {
        const double now = @NAME@_follows(j, y, at_rest, rise, &rate);
        const double elongation = decayed[j] + gain[j] * (now - t->followed[j]);
        t->state[j] = fabs(elongation) >= @FLUSH@ ? elongation : 0.0;
        t->followed[j] = now;
    }
    t->surface_mm = y;
    return depth_mm >= 0.0 ? fmax(force, 0.0) : 0.0;
}

#endif
"""


#: F_s of one polynomial, and of pieces that begin at depth (i / pieces)^2.
_ONE = """\
static inline double @NAME@_static_force(double x, double *slope)
{
    return @NAME@_continued(@NAME@_static[0], 4, x, @UPPER@_DEPTH_MM, slope);
}
"""
_PIECES = """\
/* F_s in cubic pieces; piece i begins at depth (i / pieces)^2 */
static inline double @NAME@_static_force(double x, double *slope)
{
    const double depth = @UPPER@_DEPTH_MM, pieces = @UPPER@_PIECES;
    const double inside = fmin(fmax(x, 0.0), depth);
    const int last = @UPPER@_PIECES - 1, found = (int)(pieces * sqrt(inside / depth));
    const int piece = found < last ? found : last;
    const double start = depth * (piece / pieces) * (piece / pieces);
    const double end = depth * ((piece + 1) / pieces) * ((piece + 1) / pieces);
    double s, value = @NAME@_continued(@NAME@_static[piece], 4, inside - start, end - start, &s);
    if (x > depth) {
        s = fmax(s, 0.0);
        value += s * (x - depth);
    }
    *slope = s;
    return value;
}
"""
#: What an exponential follows, and its rate by depth.
_FOLLOWS = """\
/* @WORDS@ */
static inline double @NAME@_follows(int j, double y, double at_rest, double rise, double *rate)
{
@BODY@
}
"""
_UNUSED = "    (void)j; (void)y; (void)at_rest; (void)rise;\n"
_OWN = "static const double @NAME@_own[@UPPER@_STATES][@OWN_SIZE@] = @OWN_CURVES@;\n"
_OWN_CURVE = """\
    (void)at_rest; (void)rise;
    return @NAME@_continued(@NAME@_own[j], 5, y, @UPPER@_DEPTH_MM, rate);"""
_KINDS = (
    ("an exponential follows the depth", _UNUSED + "    *rate = 1.0;\n    return y;"),
    ("an exponential follows F_s", _UNUSED + "    *rate = rise;\n    return at_rest;"),
    ("an exponential follows a curve of its own", _OWN_CURVE),
)


def c_header(bundle: Bundle) -> bytes:
    """Write the header of a tissue.

    ``bundle``: of a tissue in mm and N; of a law whose relaxation is no exponential the header holds the
    projection that a device feels, and says its error.  Returns ASCII.  Raises BundleError: it was
    normalised; UsageError: its force follows the speed over that at contact.
    """
    from tissueid import __version__
    from tissueid.model.kernels import MAX_DETACHED_ITERATIONS
    from tissueid.model.states import FLUSH_MM

    law = carried_law(bundle)
    name, (slow, fast) = _identifier(bundle.specimen), bundle.speeds_mm_s
    tip = "" if bundle.tip_radius_mm is None else f", tip radius {bundle.tip_radius_mm:g} mm"
    words, body = _KINDS[law.followed]
    # parts that hold marks come first, and what others have written last
    marks = {
        "STATIC_FORCE": _ONE if len(law.static) == 1 else _PIECES,
        "FOLLOWS": _FOLLOWS,
        "BODY": body,
        "WORDS": words,
        **_numbers(law),
        "NAME": name,
        "UPPER": name.upper(),
        "DEPTH": float(bundle.depth_mm).hex(),
        "ITERATIONS": str(MAX_DETACHED_ITERATIONS),
        "FLUSH": repr(FLUSH_MM),
        "CLAIMED": f"depth 0 to {bundle.depth_mm:g} mm, speed {slow:g} to {fast:g} mm/s{tip}",
        "VERSION": __version__,
        "LAW": _law_words(bundle, law),
        "SPECIMEN": _plain(bundle.specimen),
    }
    header = _HEADER
    for mark, text in marks.items():
        header = header.replace(f"@{mark}@", text)
    return header.encode("ascii")


def _numbers(law: ServoLaw) -> dict[str, str]:
    """Numbers of a law by their marks; without an exponential the tables have one row."""
    count = law.tau_s.size
    stiffness = np.zeros((max(count, 1), 3))
    if count:
        stiffness[:, : law.stiffness.shape[1]] = law.stiffness
    own = {"OWN": _OWN, "OWN_SIZE": str(OWN_SIZE), "OWN_CURVES": _table(law.own)}
    return {
        "BRANCHES": str(count),
        "STATES": str(max(count, 1)),
        "PIECES": str(len(law.static)),
        "UNIT": "ratio to F_s" if law.followed == STATIC else "[N/mm^(k+1)]",
        "STATIC": _table(law.static),
        "STIFFNESS": _table(stiffness),
        "TAU": _listed(law.tau_s if count else [1.0]),
        **(own if law.followed == OWN else {"OWN": ""}),
    }


def _law_words(bundle: Bundle, law: ServoLaw) -> str:
    """The law, and what the projection misses of it."""
    model = bundle.model.name or bundle.model.key
    if law.error == 0.0:
        return model
    terms = f"{law.tau_s.size} exponentials"
    return f"{model}, by {terms}: at most {100.0 * law.error:.2g} % of a sudden push's relaxing force off"


def _table(rows: FloatArray) -> str:
    return "{" + ", ".join(_listed(row) for row in rows) + "}"


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
