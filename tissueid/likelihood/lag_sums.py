"""Sums of one log for a likelihood with AR(1) noise, for every correlation at once.

Between neighbouring samples of a chain with correlation rho the innovation z_n - rho z_(n-1) has variance
1 - rho^2.  Its Gram matrix is quadratic in rho, and written with the Gram matrix D of the *differences*
z_n - z_(n-1) it loses no digits where rho is close to one::

    sum (z_n - rho z_(n-1))(.)' / (1 - rho^2) = (A - rho B) / (1 + rho) + rho D / (1 - rho^2)

A and B are the Gram matrices of the later and of the earlier sample of every link.  One triple for each
distinct sampling step h gives rho = phi^(h / reference step); chains are broken at gaps, at samples that
take no part, and at event rows.

Two products are enough.  With m and d the mean and the difference of the samples of a link the sum is::

    (1 - rho) / (1 + rho) sum m m' + (1 + rho) / (1 - rho) sum d d' / 4 + (A - B) / 2

and A - B telescopes along a chain whatever its steps.  A and B are put together from that: of one
step they are the Gram matrices above; of several, A - B is shared out among the steps by their links, because
only its sum counts.  The columns s_k x^p are one set of states times powers of x: sums over samples stay
the same where two of them change powers, so that a part of the product of means is enough.  Work: samples x
columns^2 / 2 multiply-adds for the differences and, of degree 1, three quarters of that for the means,
memory flat.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.basis import KernelBasis
from tissueid.likelihood.chains import linked_samples
from tissueid.likelihood.gram_kernels import (
    aligned_zeros,
    chunk_samples,
    places,
    tiled_columns,
)
from tissueid.likelihood.kernels import fill_powers, fill_products, fill_states
from tissueid.likelihood.lag_kernels import add_link_grams, filter_rows, split_links
from tissueid.likelihood.noise import white_part
from tissueid.likelihood.step_groups import lag_groups
from tissueid.likelihood.sums import N_STATIC, LogData, step_tables

__all__ = ["LagSums", "lag_sums"]

FloatArray = NDArray[np.float64]

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
        A, B and D of every distinct step; of several steps A - B counts in the sum alone.
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

    def tempered(self, samples: float) -> LagSums:
        """The same with all but the sum of squares of the residual divided by a number of samples.

        The last column is the residual at a point where it is least: its scale stays known, and what
        another point adds to its square counts as much less.
        """
        if samples == 1.0:
            return self
        share = np.full(self.start.shape, 1.0 / samples)
        share[-1, -1] = 1.0
        return replace(
            self,
            start=self.start * share,
            later=self.later * share,
            earlier=self.earlier * share,
            difference=self.difference * share,
        )

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
    """Sums as they grow, in columns filled up to whole registers; plain and block as in the kernels."""

    def __init__(self, groups: int, columns: int, plain: int, block: int) -> None:
        self.plain, self.block = plain, block
        self.start, self.end = np.zeros((2, columns, columns))
        self.middle, self.difference = np.zeros((2, groups, columns, columns))
        self._inside = False

    def add(self, rows: FloatArray, group: NDArray[np.int64]) -> None:
        """Count a chunk in; ``rows`` has one in front, ``group`` is -1 at starts."""
        groups = self.middle.shape[0]
        starts = np.flatnonzero(group < 0)
        if starts.size:
            self.start += _gram(rows[starts + 1])
            # before a start a chain ends, but for the first of all
            self.end += _gram(rows[starts if self._inside else starts[1:]])
            self._inside = True
        place, bound = places(np.where(group < 0, groups, group), groups + 1)
        add_link_grams(rows, place, bound, self.plain, self.block, self.middle, self.difference)

    def close(self, last: FloatArray) -> None:
        """Count the last sample of all in as the end of its chain."""
        if self._inside:
            self.end += np.outer(last, last)


def _gram(rows: FloatArray) -> FloatArray:
    return np.asarray(rows.T @ rows)


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
    nodes = basis.tau_s.size
    # the last node fills the last register
    tau = np.pad(basis.tau_s, (0, tiled_columns(nodes) - nodes), mode="edge")
    step = np.diff(data.time_s, prepend=data.time_s[0])
    tables = step_tables(step, tau, float(data.time_s[-1] - data.time_s[0]))
    linked = linked_samples(data)
    group, mean_s = lag_groups(step, linked)
    plain = tiled_columns(N_STATIC + 1)
    width = plain + tau.size * (degree + 1)
    index = _columns(nodes, tau.size, degree)
    chunk = chunk_samples(width)
    rows = aligned_zeros(chunk + 1, width)
    white, variance = white_part(phi, moving_average)
    # filtered columns are no longer states times powers of the depth
    totals = _Totals(mean_s.size, width, plain, width if white > 0.0 else tau.size)
    weights = np.zeros(width)
    weights[index[:-1]] = 0.0 if center is None else center
    rho, left, mean = phi ** (mean_s / reference_step_s), 0.0, np.zeros(width)
    state, one, order = aligned_zeros(tau.size), np.ones(step.size), np.arange(chunk)
    for first in range(0, step.size, chunk):
        last = min(first + chunk, step.size)
        inside = group[first:last][data.include[first:last]]
        used = inside.size
        after = rows[1:]
        to = data.include, order, after
        fill_powers(one, data.depth_mm, first, last, *to, 0, N_STATIC)
        fill_states(data.depth_mm, step, *tables, tau, state, first, last, *to, plain)
        if used == 0:
            continue
        fill_products(after[:used], 1, plain, tau.size, degree)
        fill_powers(data.force_N, data.depth_mm, first, last, *to, N_STATIC, 1)
        if center is not None:
            after[:used, N_STATIC] -= after[:used] @ weights
        if white > 0.0:
            left = filter_rows(inside, rho, white, variance, left, mean, rows)
        totals.add(rows[: used + 1], inside)
        rows[0] = rows[used]
    totals.close(rows[0])
    links = np.bincount(group[linked], minlength=mean_s.size).astype(np.int64)
    later, earlier, start, difference = _split(totals, links, index)
    return LagSums(
        start=start,
        later=later,
        earlier=earlier,
        difference=difference,
        ratio=mean_s / reference_step_s,
        links=links,
        chains=int(data.include.sum() - links.sum()),
        degree=degree,
        reference_step_s=reference_step_s,
    )


def _columns(nodes: int, block: int, degree: int) -> NDArray[np.int64]:
    """Where the columns ``[1, x, x^2, x^3, s_k x^p, force]`` stand in rows that fill whole registers."""
    states = tiled_columns(N_STATIC + 1) + block * np.arange(degree + 1)[:, None] + np.arange(nodes)
    return np.concatenate([np.arange(N_STATIC), states.ravel(), [N_STATIC]])


def _split(totals: _Totals, links: NDArray[np.int64], index: NDArray[np.int64]) -> tuple[FloatArray, ...]:
    """Sums over the later and the earlier samples of links, over starts of chains, and over differences."""
    share = 0.5 * links / max(links.sum(), 1)
    start, end = (part[np.ix_(index, index)] for part in (totals.start, totals.end))
    later, earlier, difference = np.empty((3, links.size, index.size, index.size))
    split_links(
        totals.middle, totals.difference, end - start, share, index, totals.plain, totals.block,
        later, earlier, difference,
    )  # fmt: skip
    return later, earlier, start, difference
