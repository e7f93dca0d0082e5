"""Quasi-linear laws beside the chosen order: which truth is told from which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import draw, handles_for, identified, small_recipe

from tissueid.flags import Flag
from tissueid.inference.choice import BEND, Rival
from tissueid.inference.specimen import _one_form, rival_flags
from tissueid.model.base import ContactPath
from tissueid.model.grammar import parsed
from tissueid.synth import Branch, Hold, Log, Move

LOGS = tuple(
    Log(f"hold-{d:.0f}-{v:.0f}", (Move(d, v), Hold(3.0)))
    for d, v in ((4.0, 60.0), (4.0, 240.0), (4.0, 600.0), (2.0, 240.0))
)
PAPER = small_recipe(branches=(Branch((10.0, 12.0), 0.3),), logs=LOGS, sigma_N=0.1)


def quasi_linear(trials):
    """The same paths, felt by a quasi-linear tissue."""
    rng = np.random.default_rng(8)
    model = parsed("polynomial * tangent * prony:1").model(8.0, 0.01, 10.0)
    theta = np.array([20.0, -1.2, 0.35, 1.5, 0.5])
    return [
        replace(
            one,
            force_N=model.force(theta, ContactPath(one.time_s, np.maximum(one.displacement_mm, 0.0)))
            + 0.1 * rng.standard_normal(one.time_s.size),
        )
        for one in trials
    ]


@pytest.mark.system
def test_a_quasi_linear_tissue_is_told_and_the_papers_is_not():
    paper = identified(handles_for(draw(PAPER, 1)), pooling="partial", branches=(1, 2), degrees=(0, 1))
    assert not any(one.better or one.disagrees for one in paper.rivals)
    assert rival_flags(paper) == ()
    other = identified(
        handles_for(quasi_linear(draw(PAPER, 1))), pooling="partial", branches=(1, 2), degrees=(0, 1)
    )
    assert any(one.better for one in other.rivals)
    (flag,) = rival_flags(other)
    assert flag.code == "form_dependent"
    assert flag.values["tau_s"] == pytest.approx(0.5, rel=0.05)


def rival(gain, apart, *, stderr=0.3):
    return Rival("polynomial * tangent * prony:1", gain, stderr, 1.84 * stderr, 0.5, 0.01, apart, None, None)


@pytest.mark.parametrize(
    ("gain", "apart", "better", "disagrees"),
    [
        (1.0, 0.0, True, False),
        (1.0, 9.0, True, True),
        (0.29, 0.5, False, False),
        (0.29, -4.0, False, True),
        (-0.5, 4.0, False, True),
        (-1.0, 9.0, False, False),
    ],
)
def test_a_law_is_better_or_ties_and_disagrees(gain, apart, better, disagrees):
    one = rival(gain, apart)
    assert (one.better, one.disagrees) == (better, disagrees)
    # a gain that is sure but small is none
    assert not rival(0.9 * BEND, 0.0, stderr=1e-3).better


def test_one_remark_on_the_form_is_enough():
    by_law = Flag("form_dependent", "a law", {"gain": 1.0})
    window = Flag("form_dependent", "a window", {"slope": 0.9})
    program = Flag("form_dependent", "a program", {"depth_mm": 4.0})
    other = Flag("bound_active", "else")
    assert _one_form((program, other, window, by_law)) == (other, by_law)
    assert _one_form((program, window, other)) == (window, other)
    assert _one_form((program, other)) == (program, other)
    assert _one_form((other,)) == (other,)
