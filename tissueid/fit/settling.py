"""The choice of a model once more, under the noise that the first one left.

The first choice takes the noise as white.  Where it is correlated, errors that last look like slow branches;
and an effect that shows in few logs can only be trusted where the noise is known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tissueid.fit.candidates import Candidate, Solution, SpecimenSums, fit_candidate
from tissueid.fit.logs import LogHandle
from tissueid.fit.selection import Choice, choose
from tissueid.fit.verdict import one_program
from tissueid.fit.whitening import Whitened
from tissueid.flags import Flag

__all__ = ["settle_choice", "undecided_flags"]


def settle_choice(
    sums: SpecimenSums,
    whitened: Whitened,
    choice: Choice,
    handles: Sequence[LogHandle],
    options: tuple[tuple[int, ...], tuple[int, ...]],
    tick: Callable[[str], None],
) -> tuple[Choice, Solution]:
    """Choose under known noise.

    Parameters
    ----------
    sums : SpecimenSums
        For white noise.
    whitened : Whitened
        The first choice under its noise.
    choice : Choice
        The first one.
    handles : sequence of LogHandle
    options : tuple
        Branches and degrees that may be chosen.
    tick : callable

    Returns
    -------
    choice : Choice
    solution : Solution
        Of the chosen candidate, for white noise.
    """
    branches, degrees = options
    # white noise leaves the sums as they are
    same = whitened.sums is sums
    again = choose(
        whitened.sums,
        branches=branches,
        degrees=degrees,
        pooling=choice.solution.candidate.pooling,
        one_speed=one_program([handle.facts for handle in handles]),
        noise=whitened.noise,
        start=() if same else choice.candidates,
        ready=(*choice.candidates, *choice.idle) if same else (),
        progress=tick,
    )
    wanted = again.solution.candidate
    for one in choice.candidates:
        if one.candidate == wanted:
            return again, one
    return again, fit_candidate(sums, wanted, seeds=[again.solution.evaluation.log_tau])


def _words(candidate: Candidate) -> str:
    number = "1 branch" if candidate.branches == 1 else f"{candidate.branches} branches"
    return f"{number} with K of degree {candidate.degree}"


def undecided_flags(choice: Choice) -> tuple[Flag, ...]:
    """A flag where the data do not decide between the chosen model and others."""
    if not choice.undecided:
        return ()
    rivals = [_words(one) for one in choice.undecided]
    return (
        Flag(
            "model_undecided",
            f"{_words(choice.solution.candidate)} taken; {len(rivals)} other"
            f"{'s predict' if len(rivals) > 1 else ' predicts'} held-out data as well",
            {"rivals": rivals},
        ),
    )
