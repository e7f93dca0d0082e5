"""A folder of one recording under several names, and its inspection that takes corrections."""

from pathlib import Path

import numpy as np

from tissueid.ingest import ReadOptions, read_trials
from tissueid.ingest.manifest import read_study
from tissueid.segment import SegmentOptions
from tissueid.study.corrections import CorrectedInspection
from tissueid.study.inspected import Inspection


def corrected(lab: Path, *names: str) -> CorrectedInspection:
    """Write 1 mm of air, 3 mm at 1 mm/s, a hold of 10 s under each name; inspected with the study there."""
    time = np.arange(0.0, 14.0, 0.02)
    x = np.minimum(time, 4.0)
    depth = np.maximum(x - 1.0, 0.0)
    force = 2.0 * depth * (1.0 + np.where(time < 4.0, 1.0, np.exp(-(time - 4.0) / 2.0)))
    force += np.random.default_rng(2).normal(0.0, 0.002, time.size)
    rows = [f"{t:.3f},{place:.5f},{f:.5f}" for t, place, f in zip(time, x, force, strict=True)]
    for name in names:
        text = "\n".join(["Time,Extension,Load", "(s),(mm),(N)", *rows, ""])
        (lab / name).write_text(text, encoding="ascii")
    manifest = lab / "study.toml"

    def inspect() -> Inspection:
        study = read_study(manifest) if manifest.exists() else None
        found = Inspection(SegmentOptions(), study, lab, drawn=True)
        for name in names:
            for trial in read_trials(lab / name):
                found.add(trial)
        return found

    return CorrectedInspection(manifest, inspect, ReadOptions())
