"""What the sampler of a population costs by size of cohort: seven quantities, 100 to 10,000 specimens.

Each specimen has 500 draws of a normal posterior, narrower than the spread between specimens for one half of
the quantities and as wide for the other.  The clock is that of the process: a busy machine
changes little; ratios count.  A specimen and sweep should cost no more at 10,000 than at 100.

    python benchmarks/population.py [--json] [--sizes 100,1000,10000]
"""

from __future__ import annotations

import json
import sys
import time
import tracemalloc

import numpy as np
from harness import command_line

from tissueid.population.sampler import SamplerOptions, sample_population
from tissueid.population.stage_one import Design, StageOne

SIZES = (100, 1000, 10_000)
QUANTITIES, DRAWS = 7, 500
BETWEEN = 0.15
OWN = np.array([0.02, 0.02, 0.02, 0.05, 0.15, 0.15, 0.2])
#: Short: what a sweep costs does not depend on how many there are.
SHORT = SamplerOptions(settle=20, draws=1280, blocks=1)
SEED = 20260611


def stage_of(count: int) -> StageOne:
    """Specimens around one place, their posteriors by draws."""
    rng = np.random.default_rng([SEED, count])
    measured = BETWEEN * rng.standard_normal((count, QUANTITIES)) + OWN * rng.standard_normal(
        (count, QUANTITIES)
    )
    phi = tuple(one + OWN * rng.standard_normal((DRAWS, QUANTITIES)) for one in measured)
    return StageOne(
        phi, tuple(np.zeros(DRAWS) for _ in phi), np.zeros(QUANTITIES, bool), np.zeros(0, np.int64)
    )


def plain_design(count: int) -> Design:
    """No covariates and no levels."""
    return Design(np.ones((count, 1)), ("mean",), np.zeros((0, count), dtype=np.int64))


def main() -> int:
    """Run and print."""
    parser = command_line(__doc__)
    parser.add_argument("--sizes", default=",".join(map(str, SIZES)))
    given = parser.parse_args()
    sizes = [int(one) for one in given.sizes.split(",")]
    rows = []
    for count in sizes:
        stage = stage_of(count)
        tracemalloc.start()
        begun, wall = time.process_time(), time.perf_counter()
        sample_population(stage, plain_design(count), None, SHORT)
        seconds, wall = time.process_time() - begun, time.perf_counter() - wall
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        rows.append(
            {
                "specimens": count,
                "processor_s": round(seconds, 2),
                "wall_s": round(wall, 2),
                "ms_per_specimen": round(1e3 * seconds / count, 3),
                "bytes_per_specimen": round(peak / count),
            }
        )
        if not given.json:
            sys.stdout.write(f"{rows[-1]}\n")
            sys.stdout.flush()
    found = {
        "rows": rows,
        "ratio_of_cost_a_specimen": round(rows[-1]["ms_per_specimen"] / rows[0]["ms_per_specimen"], 3),
    }
    sys.stdout.write(json.dumps(found, indent=1) + "\n" if given.json else f"{found}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
