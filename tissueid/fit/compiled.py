"""Which compiled functions of a fit are not in numba's cache yet, so that a first run can say so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tissueid.likelihood import marginal, partial
from tissueid.likelihood.cone import cone_least_squares
from tissueid.likelihood.density_lanes import conditionals, log_ratios
from tissueid.likelihood.gram_kernels import places, tiled_grams
from tissueid.likelihood.instrument_kernels import instrument_force
from tissueid.likelihood.kernels import fill_powers, fill_products, fill_states
from tissueid.likelihood.knot_kernels import accumulate, corner_flags
from tissueid.likelihood.knot_terms import log_terms, without_effects
from tissueid.likelihood.lag_kernels import filter_chain, split_links, tiled_link_grams
from tissueid.likelihood.passive_normal import log_passive_mass
from tissueid.model.kernels import branch_state

__all__ = ["first_run_words", "kernels_to_compile"]

KERNELS: tuple[Any, ...] = (
    branch_state,
    fill_powers,
    fill_products,
    fill_states,
    tiled_grams,
    places,
    filter_chain,
    tiled_link_grams,
    split_links,
    cone_least_squares,
    partial.coefficients,
    partial.objective,
    partial.assemble,
    partial.solve,
    corner_flags,
    accumulate,
)
#: A posterior needs these as well; others only close to the edge of what is passive, or for many logs.
POSTERIOR_KERNELS: tuple[Any, ...] = (
    marginal.log_marginals,
    marginal.log_shares,
    marginal.conditionals,
    marginal.draw_effects,
    log_passive_mass,
    instrument_force,
    log_terms,
    without_effects,
    conditionals,
    log_ratios,
)


def first_run_words(*, posterior: bool) -> str | None:
    """What is said before functions are compiled, with the time that takes; ``None`` where they all are.

    Parameters
    ----------
    posterior : bool
        Count those of a posterior in.
    """
    missing = kernels_to_compile(posterior=posterior)
    if not missing:
        return None
    names = {kernel.__name__ for kernel in POSTERIOR_KERNELS}
    time = "about 4 minutes" if names & set(missing) else "about half a minute"
    return f"First run: compiling {len(missing)} functions, {time}, once; later runs start at once"


def kernels_to_compile(*, posterior: bool = False) -> list[str]:
    """Names of the kernels that the next call compiles; none where compilation is switched off.

    Parameters
    ----------
    posterior : bool
        Count those of a posterior in.
    """
    missing = []
    for kernel in (*KERNELS, *(POSTERIOR_KERNELS if posterior else ())):
        stats = getattr(kernel, "stats", None)
        # the folder is named by the sources: whatever is in it is of these
        if stats is not None and not any(Path(stats.cache_path).glob(f"*.{kernel.__name__}-*.nbi")):
            missing.append(kernel.__name__)
    return missing
