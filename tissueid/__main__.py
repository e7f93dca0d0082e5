"""``python -m tissueid``."""

from __future__ import annotations

from tissueid.cli.main import run

if __name__ == "__main__":
    run()
