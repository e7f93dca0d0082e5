"""Sums of one log for a likelihood with AR(1) noise, for every correlation at once.

Between neighbouring samples of a chain with correlation rho the innovation z_n - rho z_(n-1) has variance
1 - rho^2.  Its Gram matrix is quadratic in rho, and written with the Gram matrix D of the *differences*
z_n - z_(n-1) it loses no digits where rho is close to one::

    sum (z_n - rho z_(n-1))(.)' / (1 - rho^2) = (A - rho B) / (1 + rho) + rho D / (1 - rho^2)

A and B are the Gram matrices of the later and of the earlier sample of every link.  One triple for each
distinct sampling step h gives rho = phi^(h / reference step); chains are broken at gaps, at samples that
take no part, and at event rows.

Over a stretch of links of one step B is A, plus the row before the stretch, less its last row: two matrix
products a chunk, A and D, make the sums of a log of few rates; where steps alternate B is a third.  Work:
samples x columns^2 multiply-adds for A and as many for D, memory flat.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.basis import KernelBasis
from tissueid.likelihood.chains import linked_samples
from tissueid.likelihood.kernels import fill_design
from tissueid.likelihood.lag_kernels import filter_rows, link_rows
from tissueid.likelihood.noise import white_part
from tissueid.likelihood.step_groups import lag_groups
from tissueid.likelihood.sums import N_STATIC, LogData, step_tables

__all__ = ["LagSums", "lag_sums"]

FloatArray = NDArray[np.float64]

#: Rows of one matrix product; design rows and differences stay near the second-level cache.
CHUNK = 640
#: A chunk with more stretches of equal steps is sorted by step instead.
MAX_STRETCHES = 8
#: Rows at the ends of stretches are summed by so many.
EDGE_ROWS = 256
#: Step ratios that agree to so many digits of their logarithm are one.
RATIO_DIGITS = 9


@dataclass(frozen=True, slots=True, eq=False)
class LagSums:
    """Gram matrices of one log; the columns are those of :class:`tissueid.likelihood.sums.LogSums`.

    Attributes
    ----------
    start : ndarray, shape (m, m)
        Gram matrix of the samples that start a chain.
    later, earlier, difference : ndarray, shape (groups, m, m)
        A, B and D of every distinct step.
    ratio : ndarray, shape (groups,)
        Step over the reference step.
    links : ndarray of int, shape (groups,)
    chains : int
    degree : int
        Highest power of x that multiplies a node state.
    reference_step_s : float
    """

    start: FloatArray
    later: FloatArray
    earlier: FloatArray
    difference: FloatArray
    ratio: FloatArray
    links: NDArray[np.int64]
    chains: int
    degree: int
    reference_step_s: float

    @property
    def count(self) -> int:
        """Samples in the likelihood."""
        return self.chains + int(self.links.sum())

    def whitened(self, phi: float) -> tuple[FloatArray, float]:
        """Gram matrix of the whitened columns and ln det of the correlation matrix.

        Parameters
        ----------
        phi : float
            Correlation over one reference step, in [0, 1).

        Returns
        -------
        gram : ndarray, shape (m, m)
            ``Z' R^-1 Z``.
        log_det : float
            ``ln det R``.
        """
        rho = phi**self.ratio
        gram = self.start.copy()
        for k, r in enumerate(rho):
            gram += (self.later[k] - r * self.earlier[k]) / (1.0 + r)
            gram += r / (1.0 - r * r) * self.difference[k]
        return gram, float(self.links @ np.log1p(-rho * rho))

    def merged(self, other: LagSums) -> LagSums:
        """Sums of both logs as of one record of separate chains.

        Raises
        ------
        ValueError
            The sums are of other columns, or count steps in another unit.
        """
        mine = (self.start.shape, self.degree, self.reference_step_s)
        if mine != (other.start.shape, other.degree, other.reference_step_s):
            msg = "sums of different columns or reference steps can't be added"
            raise ValueError(msg)
        ratio = np.concatenate([self.ratio, other.ratio])
        _, first, place = np.unique(
            np.round(np.log(ratio), RATIO_DIGITS), return_index=True, return_inverse=True
        )

        def add(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
            out = np.zeros((first.size, *a.shape[1:]), dtype=a.dtype)
            np.add.at(out, place, np.concatenate([a, b]))
            return out

        return replace(
            self,
            start=self.start + other.start,
            later=add(self.later, other.later),
            earlier=add(self.earlier, other.earlier),
            difference=add(self.difference, other.difference),
            ratio=ratio[first],
            links=add(self.links, other.links),
            chains=self.chains + other.chains,
        )


class _Totals:
    """Sums as they grow: ``excess`` is what B has more than A."""

    def __init__(self, groups: int, columns: int) -> None:
        self.start = np.zeros((columns, columns))
        self.later, self.excess, self.difference = np.zeros((3, groups, columns, columns))
        self._edges: list[tuple[int, FloatArray, FloatArray]] = []

    def add(self, rows: FloatArray, change: FloatArray, group: NDArray[np.int64]) -> None:
        """Count a chunk in; ``rows`` and ``change`` have one row in front, ``group`` is -1 at starts."""
        bounds = [0, *(np.flatnonzero(np.diff(group)) + 1).tolist(), group.size]
        if len(bounds) <= MAX_STRETCHES + 1:
            for first, last in pairwise(bounds):
                k = int(group[first])
                self._add_links(k, rows[first + 1 : last + 1], change[first + 1 : last + 1])
                if k >= 0:
                    self._edges.append((k, rows[first].copy(), rows[last].copy()))
            if len(self._edges) > EDGE_ROWS:
                self.add_edges()
            return
        for k in np.unique(group).tolist():
            at = np.flatnonzero(group == k)
            later = self._add_links(k, rows.take(at + 1, axis=0), change.take(at + 1, axis=0))
            if k >= 0:
                earlier = rows.take(at, axis=0)
                self.excess[k] += earlier.T @ earlier - later

    def _add_links(self, k: int, later: FloatArray, change: FloatArray) -> FloatArray:
        gram = later.T @ later
        if k < 0:
            self.start += gram
        else:
            self.later[k] += gram
            self.difference[k] += change.T @ change
        return gram

    def add_edges(self) -> None:
        """Count the ends of stretches in: the row before one, less its last row."""
        for k in range(self.excess.shape[0]):
            ends = np.array([(a, b) for group, a, b in self._edges if group == k])
            if ends.size:
                first, last = ends[:, 0], ends[:, 1]
                self.excess[k] += first.T @ first - last.T @ last
        self._edges.clear()


def lag_sums(
    data: LogData,
    basis: KernelBasis,
    *,
    degree: int,
    reference_step_s: float,
    center: FloatArray | None = None,
    moving_average: float = 0.0,
    phi: float = 0.0,
) -> LagSums:
    """Sum one log over the nodes of a basis, neighbouring samples apart from single ones.

    Samples are linked where two neighbours of the record both take part and no break lies between them; a
    thinned log therefore has no links.  Safe to run in threads; the order of adding is fixed.

    Parameters
    ----------
    data : LogData
        ``fold`` is not looked at.
    basis : KernelBasis
    degree : int
        Highest degree of K that will be asked for.
    reference_step_s : float
        Step over which phi is the correlation [s].
    center : ndarray, shape (m - 1,), optional
        Weights of the columns that predict the force: the last column becomes ``force - columns @ center``,
        so that the sums are of the size of the residuals and low noise loses no digits.
    moving_average, phi : float
        theta and phi of white plus AR(1) noise as an ARMA(1,1) process over the reference step: every column
        is filtered chain by chain, which leaves AR(1) noise.  In the middle of a chain of such steps that is
        ``zeta_n = z_n + theta zeta_(n-1)`` for any phi; at its start, and over other steps, it is exact for
        the phi that is given.

    Returns
    -------
    LagSums
        With ``4 + nodes * (degree + 1) + 1`` columns, at most
        :data:`~tissueid.likelihood.step_groups.MAX_LAG_GROUPS` distinct steps.
    """
    tau = basis.tau_s
    step = np.diff(data.time_s, prepend=data.time_s[0])
    tables = step_tables(step, tau, float(data.time_s[-1] - data.time_s[0]))
    linked = linked_samples(data)
    group, mean_s = lag_groups(step, linked)
    columns = N_STATIC + tau.size * (degree + 1) + 1
    totals = _Totals(mean_s.size, columns)
    white, variance = white_part(phi, moving_average)
    rho, left, mean = phi ** (mean_s / reference_step_s), 0.0, np.zeros(columns)
    state = np.zeros(tau.size)
    rows, change = np.zeros((2, CHUNK + 1, columns))
    for first in range(0, step.size, CHUNK):
        last = min(first + CHUNK, step.size)
        count = fill_design(
            data.depth_mm, step, *tables, tau, state, first, last,
            data.include, data.force_N, degree, rows[1:],
        )  # fmt: skip
        if count == 0:
            continue
        if center is not None:
            rows[1 : count + 1, -1] -= rows[1 : count + 1, :-1] @ center
        inside = group[first:last][data.include[first:last]]
        if white > 0.0:
            left = filter_rows(inside, rho, white, variance, left, mean, rows)
        link_rows(inside, rows, change)
        totals.add(rows[: count + 1], change[: count + 1], inside)
        rows[0] = rows[count]
    totals.add_edges()
    links = np.bincount(group[linked], minlength=mean_s.size)
    return LagSums(
        start=totals.start,
        later=totals.later,
        earlier=totals.later + totals.excess,
        difference=totals.difference,
        ratio=mean_s / reference_step_s,
        links=links.astype(np.int64),
        chains=int(data.include.sum() - links.sum()),
        degree=degree,
        reference_step_s=reference_step_s,
    )
