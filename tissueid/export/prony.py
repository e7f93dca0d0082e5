"""A Prony series for finite elements: the law linearised about a depth d that has been held for long.

A small step dx gives dF(t) = [F_s'(d) + sum_j K_j(d) exp(-t / tau_j)] dx.  The modulus itself depends on tip
and geometry and is left to whoever builds the finite-element model.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.sax.saxutils import escape

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import UsageError, refuse
from tissueid.model.base import MOST_BRANCHES
from tissueid.model.servo_law import SPEED, ServoLaw, servo_law
from tissueid.store.bundle import Bundle

#: Terms that FEBio's material holds.
FEBIO_TERMS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Prony:
    """Small motion about a depth."""

    specimen: str
    depth_mm: float
    long_term_N_per_mm: float  # static tangent, F_s'
    branch_N_per_mm: FloatArray  # (terms,)
    tau_s: FloatArray  # (terms,)
    #: Largest error by projecting the relaxation on so many terms, over that of a sudden push.
    error: float = 0.0

    @property
    def instantaneous_N_per_mm(self) -> float:
        """Tangent of a step that is too fast to relax."""
        return self.long_term_N_per_mm + float(self.branch_N_per_mm.sum())


def carried_law(bundle: Bundle, most: int = MOST_BRANCHES) -> ServoLaw:
    """The law that a format of exponentials takes."""
    bundle.require_renderable()
    law = servo_law(bundle.contact_model(), bundle.theta, most)
    if law.followed == SPEED:
        refuse(
            f"{bundle.specimen}: {bundle.model.name!r} follows the speed over that at contact, which none of "
            f"the {most} terms of this format can; export its parameters by --format mat or json"
        )
    return law


def linearised(bundle: Bundle, depth_mm: float | None = None, *, most: int = MOST_BRANCHES) -> Prony:
    """Linearise a tissue about a depth.

    ``depth_mm``: half of the claimed depth where none is given; ``most``: terms on which a relaxation that is
    no exponential is projected.  Raises UsageError: there are more or no terms, the depth is not claimed, or
    the static force does not rise there.
    """
    model, law = bundle.contact_model(), carried_law(bundle, most)
    if not 0 < law.tau_s.size <= most:
        more = f"; abaqus and c-header take up to {MOST_BRANCHES}" if most < law.tau_s.size else ""
        msg = f"{bundle.specimen}: this format takes 1 to {most} terms, the tissue has {law.tau_s.size}{more}"
        raise UsageError(msg)
    depth = 0.5 * bundle.depth_mm if depth_mm is None else depth_mm
    if not 0.0 < depth <= bundle.depth_mm:
        msg = f"{bundle.specimen}: --depth {depth:g} is outside what is claimed, 0 to {bundle.depth_mm:g} mm"
        raise UsageError(msg)
    tangent = float(model.static_slope(bundle.theta, np.array([depth]))[0])
    if not tangent > 0.0:
        refuse(
            f"{bundle.specimen}: at {depth:g} mm the static force does not rise ({tangent:.3g} N/mm), which "
            "no Prony series can say; give another --depth"
        )
    branches = law.linearised(model, bundle.theta, np.array([depth]))[0][:, 0]
    return Prony(bundle.specimen, depth, tangent, branches, np.asarray(law.tau_s), law.error)


def _said(prony: Prony) -> list[str]:
    """Remarks for the reader of a card."""
    stiffness = (
        f"tangent stiffness under the tip: {prony.long_term_N_per_mm:.6g} N/mm after long, "
        f"{prony.instantaneous_N_per_mm:.6g} N/mm at once"
    )
    projected = f"relaxation by {prony.tau_s.size} terms, at most {100.0 * prony.error:.2g} % off"
    return [
        *([projected] if prony.error else []),
        f"tissueid: {prony.specimen}, linearised about {prony.depth_mm:g} mm, for small motion there",
        stiffness,
        "the elastic modulus depends on tip and geometry and is not given here; not a medical device",
    ]


def abaqus_card(prony: Prony) -> bytes:
    """``*VISCOELASTIC, TIME=PRONY``: shares of the instantaneous shear modulus, times [s]; no bulk terms."""
    lines = [f"** {line}" for line in _said(prony)]
    lines += [
        "** goes below *ELASTIC, MODULI=INSTANTANEOUS (or LONG TERM) of the material",
        "*VISCOELASTIC, TIME=PRONY",
    ]
    shares = prony.branch_N_per_mm / prony.instantaneous_N_per_mm
    lines += [f"{share:.9g}, 0., {tau:.9g}" for share, tau in zip(shares, prony.tau_s, strict=True)]
    return ("\n".join(lines) + "\n").encode("ascii", "replace")


def febio_card(prony: Prony) -> bytes:
    """A ``viscoelastic`` material: terms over the long-term response, and their times [s].

    FEBio's relaxation function is ``1 + sum g_i exp(-t / t_i)`` over the elastic material inside, which is
    the long-term one; its modulus is left open on purpose.
    """
    terms = prony.branch_N_per_mm / prony.long_term_N_per_mm
    rows = []
    for place in range(FEBIO_TERMS):
        g, t = (terms[place], prony.tau_s[place]) if place < terms.size else (0.0, 1.0)
        rows.append(f"  <g{place + 1}>{g:.9g}</g{place + 1}>\n  <t{place + 1}>{t:.9g}</t{place + 1}>")
    said = "\n".join(f"     {line}" for line in _said(prony)).replace("--", "- -")
    name = escape(prony.specimen, {'"': "&quot;"})
    text = (
        f"<!--\n{said}\n-->\n"
        f'<material id="1" name="{name}" type="viscoelastic">\n'
        + "\n".join(rows)
        + '\n  <elastic type="neo-Hookean">\n'
        "    <E></E><!-- long-term modulus of your model -->\n    <v></v>\n"
        "  </elastic>\n</material>\n"
    )
    return text.encode("utf-8")
