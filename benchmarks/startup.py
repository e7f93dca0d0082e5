"""Time of ``tissueid --help`` against ``python -c "import click"``, whole processes in turn.

    python benchmarks/startup.py [--pairs 15]

The floor is the interpreter and click; the bar is 1.5 times that.
"""

from __future__ import annotations

import statistics
import sys

from harness import command_line, run

OURS = ("-c", "import sys; from tissueid.cli.main import main; sys.exit(main(['--help']))")
PEER = ("-c", "import click")
BAR = 1.5


def main() -> int:
    """Print the median ratio of interleaved pairs."""
    parser = command_line(__doc__, json_words=None)
    parser.add_argument("--pairs", type=int, default=15)
    pairs = parser.parse_args().pairs
    run(*OURS), run(*PEER)
    times = [(run(*OURS)[0], run(*PEER)[0]) for _ in range(pairs)]
    ratio = statistics.median(a / b for a, b in times)
    ours, peer = (statistics.median(column) for column in zip(*times, strict=True))
    print(f"tissueid --help {ours:.3f} s, import click {peer:.3f} s, ratio {ratio:.2f} (bar {BAR})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
