"""Protocol and tissue of recordings: read, segmented and fitted once, to centre the priors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from tissueid.collection import Collected, TrialCache, collect, display_names
from tissueid.errors import InputError, UsageError
from tissueid.fit.logs import LogHandle
from tissueid.fit.specimen import FitOptions, fit_with_state
from tissueid.fit.tip import tip_handles
from tissueid.manifest import Study
from tissueid.segment import SegmentOptions
from tissueid.selfcheck.protocol import Centre, Protocol, of_fit, of_handles
from tissueid.store.bundle import Bundle
from tissueid.store.files import sha256_of
from tissueid.trial import Source, Trial

__all__ = ["inputs_there", "of_bundle_inputs", "of_recordings"]

#: A bundle's contact points were refined by its fit: depths may differ by a little.
DEPTH_TOLERANCE = 0.02

_Progress = Callable[[str, int, int], None]
_Reload = Callable[[Source], Trial]


def _collected(
    trials: Iterable[Trial], reload: _Reload, study: Study | None, progress: _Progress
) -> Collected:
    return collect(trials, SegmentOptions(), TrialCache(reload), progress, study)


def _handles(handles: Sequence[LogHandle], study: Study | None, progress: _Progress) -> list[LogHandle]:
    """Logs in the displacement of the tip, where the study knows the frame."""
    frame = None if study is None else study.calibration.frame
    if frame is None:
        return list(handles)
    return list(tip_handles(handles, frame, lambda text: progress(text, 0, 0)))


def of_recordings(
    trials: Iterable[Trial],
    *,
    study: Study | None,
    specimen: str | None,
    reload: _Reload,
    progress: _Progress,
    where: str,
) -> tuple[str, Protocol, Centre]:
    """Name, protocol and fitted tissue of one specimen of some recordings.

    Raises
    ------
    InputError
        Nothing can be fitted.
    UsageError
        There are several specimens and none, or another, was named.
    """
    collected = _collected(trials, reload, study, progress)
    names = {name: key for key, name in display_names(collected.sources).items()}
    if not names:
        why = f"; the first: {collected.left_out[0]}" if collected.left_out else ""
        message = f"holds nothing that can be fitted{why}"
        raise InputError(code="no_contact", message=message, path=where)
    if specimen is None and len(names) > 1:
        msg = f"{where} holds {len(names)} specimens: choose one with --specimen: {', '.join(names)}"
        raise UsageError(msg)
    name = specimen or next(iter(names))
    if name not in names:
        msg = f"{where} holds no specimen {name!r}; there are {', '.join(names)}"
        raise UsageError(msg)
    handles = _handles(collected.groups[names[name]], study, progress)
    fitted = fit_with_state(name, handles, options=FitOptions(), tick=lambda text: progress(text, 0, 0))
    protocol = of_handles(handles, lambda text: progress(text, 0, 0))
    return name, protocol, of_fit(fitted.fit, fitted.whitened.noise, logs=len(handles))


def inputs_there(bundle: Bundle) -> list[dict[str, Any]]:
    """The recordings behind a bundle, where every one is still there and unchanged; empty otherwise."""
    inputs = [dict(entry) for entry in bundle.provenance.get("inputs", ())]
    for entry in inputs:
        path = Path(str(entry.get("path", "")))
        if not path.is_file() or sha256_of(path) != entry.get("sha256"):
            return []
    return inputs


def of_bundle_inputs(
    trials: Iterable[Trial],
    bundle: Bundle,
    *,
    study: Study | None,
    reload: _Reload,
    progress: _Progress,
) -> Protocol | None:
    """The measured x(t) behind a bundle; ``None`` where the recordings are no longer fitted alike."""
    wanted = {(entry["path"], entry["sheet"]) for entry in inputs_there(bundle)}

    def own() -> Iterable[Trial]:
        return (trial for trial in trials if (trial.source.path, trial.source.sheet) in wanted)

    collected = _collected(own(), reload, study, progress)
    handles = [handle for group in collected.groups.values() for handle in group]
    if len(handles) != len(wanted):
        return None
    protocol = of_handles(_handles(handles, study, progress), lambda text: progress(text, 0, 0))
    # the passive set and the curves of the bundle end at its depth: samples beyond are none of its claims
    return protocol if protocol.depth_mm <= bundle.depth_mm * (1.0 + DEPTH_TOLERANCE) else None
