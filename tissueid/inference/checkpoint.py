"""A chain on its way, in a file that a killed run goes on from."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import emcee
import numpy as np
from numpy.typing import NDArray

from tissueid.store.files import write_file

__all__ = ["Checkpoint"]

FloatArray = NDArray[np.float64]


class Checkpoint:
    """State of a sampler in one file, written apart and renamed.

    Parameters
    ----------
    path : Path or None
        ``None`` keeps nothing.
    key : str
        Of everything the chain depends on; a file with another key is not used.
    """

    def __init__(self, path: Path | None, key: str) -> None:
        self.path, self.key = path, key

    def resume(
        self, sampler: Any, start: FloatArray, rng: np.random.Generator, seed: int
    ) -> tuple[Any, list[FloatArray], list[FloatArray]]:
        """State, chain and densities so far; both generators stand where they stood."""
        numbers = np.random.RandomState(seed & 0xFFFFFFFF)
        saved = self._read()
        if saved is None or saved["state"][0].shape != start.shape:
            sampler._random = numbers  # noqa: SLF001
            return emcee.State(start, random_state=numbers.get_state()), [], []
        coordinates, level, random = saved["state"]
        rng.bit_generator.state = saved["generator"]
        state = emcee.State(coordinates, log_prob=level, random_state=random)
        return state, list(saved["chain"]), list(saved["levels"])

    def _read(self) -> dict[str, Any] | None:
        if self.path is None or not self.path.is_file():
            return None
        try:
            with np.load(self.path, allow_pickle=False) as found:
                if str(found["key"]) != self.key:
                    return None
                generator = json.loads(str(found["generator"]))
                random = ("MT19937", found["random"], int(found["place"]), 0, 0.0)
                return {
                    "state": (found["coordinates"], found["level"], random),
                    "generator": generator,
                    "chain": [found["chain"]],
                    "levels": [found["levels"]],
                }
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
            return None

    def write(
        self, state: Any, chain: list[FloatArray], levels: list[FloatArray], rng: np.random.Generator
    ) -> None:
        """Keep what there is."""
        if self.path is None:
            return
        random = state.random_state
        buffer = io.BytesIO()
        np.savez(
            buffer,
            key=np.array(self.key),
            generator=np.array(json.dumps(rng.bit_generator.state)),
            random=random[1],
            place=np.array(random[2]),
            coordinates=state.coords,
            level=state.log_prob,
            chain=np.concatenate(chain),
            levels=np.concatenate(levels),
        )
        write_file(self.path, buffer.getvalue())
