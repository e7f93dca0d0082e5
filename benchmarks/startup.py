"""Time of ``tissueid --help`` against ``python -c "import click"``, whole processes in turn.

    python benchmarks/startup.py [--pairs 15]

The floor is the interpreter and click; the bar is 1.5 times that.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time

OURS = [sys.executable, "-c", "import sys; from tissueid.cli.main import main; sys.exit(main(['--help']))"]
PEER = [sys.executable, "-c", "import click"]
BAR = 1.5


def seconds(command: list[str]) -> float:
    """Wall time of one whole process."""
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def main() -> int:
    """Print the median ratio of interleaved pairs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=15)
    pairs = parser.parse_args().pairs
    seconds(OURS), seconds(PEER)
    times = [(seconds(OURS), seconds(PEER)) for _ in range(pairs)]
    ratio = statistics.median(a / b for a, b in times)
    ours, peer = (statistics.median(column) for column in zip(*times, strict=True))
    print(f"tissueid --help {ours:.3f} s, import click {peer:.3f} s, ratio {ratio:.2f} (bar {BAR})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
