"""One law and order of a study: the simplest that predicts as well as the best over all its specimens."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tissueid.inference.choice import tolerated
from tissueid.inference.specimen import FitOptions
from tissueid.model.grammar import KELVIN_VOIGT, parsed
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.yardstick import YARDSTICK


@dataclass(frozen=True, slots=True, order=True)
class LawOrder:
    """Law of a specimen with its number of branches and the degree of K."""

    model: str  # key or name, as ``fit --model`` takes it
    branches: int
    degree: int

    @classmethod
    def of_fit(cls, fitted: Mapping[str, Any]) -> LawOrder:
        """Order of a specimen in identification.json."""
        model = fitted["model"]
        name = KELVIN_VOIGT if model["key"] == KELVIN_VOIGT else model["name"]
        return cls(name, model["branches"], model["stiffness_degree"])

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        if self.model == KELVIN_VOIGT:
            return len(kelvin_voigt(self.branches, self.degree, 1.0).parameters)
        return len(parsed(self.model).model(1.0, 0.1, 1.0).parameters)

    def taken_by(self, options: FitOptions) -> FitOptions:
        """Options of a fit of this law and order alone."""
        if self.model != KELVIN_VOIGT:
            return replace(options, model=self.model)
        return replace(options, model=KELVIN_VOIGT, branches=self.branches, stiffness_degree=self.degree)

    def __str__(self) -> str:
        if self.model != KELVIN_VOIGT:
            return self.model
        return f"{self.branches} branch{'es' * (self.branches > 1)}, K of degree {self.degree}"


def scores_of(fitted: Mapping[str, Any], *, laws: bool) -> dict[LawOrder, float]:
    """Score of every order that a specimen was tried with; ``laws``: of other laws too, the mark aside."""
    rows = [(row.get("model") or KELVIN_VOIGT, row) for row in fitted["selection"]]
    return {
        LawOrder(name, row["branches"], row["stiffness_degree"]): row["score"]
        for name, row in rows
        if name == KELVIN_VOIGT or (laws and name != YARDSTICK)
    }


def agreed(tables: Sequence[Mapping[LawOrder, float]]) -> LawOrder | None:
    """The order of several specimens; None where half of them have tried none in common.

    Scores are logarithms of mean square errors of what was left out.  An order that a specimen was not tried
    with, or does not resolve, predicts there as well as the best of those that it contains.  As good as the
    best is what loses less than one standard error over specimens, by Student's t; of these the one of fewest
    parameters is taken.
    """
    tried = Counter(order for one in tables for order in one)
    usual = sorted(order for order, count in tried.items() if 2 * count >= len(tables))
    score = np.array([[_score(one, order) for order in usual] for one in tables])
    known = np.isfinite(score).all(axis=0) if usual else np.zeros(0, dtype=bool)
    if not known.any():
        return None
    orders, score = [order for order, kept in zip(usual, known, strict=True) if kept], score[:, known]
    lost = score[:, [int(np.argmax(score.mean(axis=0)))]] - score
    mean, error = lost.mean(axis=0), lost.std(axis=0, ddof=1) / np.sqrt(len(tables))
    as_good = np.flatnonzero(mean <= tolerated(error, len(tables)))
    return orders[min(as_good.tolist(), key=lambda k: (orders[k].parameters, mean[k]))]


def _score(table: Mapping[LawOrder, float], order: LawOrder) -> float:
    """Score of an order, or the best of those that it contains; minus infinity where there is none."""
    if order in table:
        return table[order]
    inside = (
        score
        for one, score in table.items()
        if one.model == order.model == KELVIN_VOIGT
        and one.branches <= order.branches
        and one.degree <= order.degree
    )
    return max(inside, default=-np.inf)
