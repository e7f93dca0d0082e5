"""A log that can be loaded again, with what is known of it, and its blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from tissueid.errors import InputError
from tissueid.inference.blocks import Blocks, log_blocks
from tissueid.inference.channel_law import with_speed_ratio
from tissueid.inference.window import FittedLog, FreeSurface, assign_folds, fitted_log, with_holds_cut
from tissueid.model.grammar import Candidates
from tissueid.trial import Segmentation, Trial

#: Code of a log without a contact that its law could follow.
NO_CONTACT = "no_contact"
#: Smallest standard deviation of a contact point, as a fraction of the depth.
OFFSET_SD_FLOOR = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class LogHandle:
    """A trial that can be loaded again, with what is known of it."""

    load: Callable[[], Trial]  # returns the trial
    segmentation: Segmentation
    facts: FittedLog  # without its samples
    #: Standard deviation of the contact point as segmented: the prior of the fit's contact offset.
    contact_sd_mm: float
    contact_shift_mm: float = 0.0  # how far the fit has moved the contact point since
    guard: bool = False  # see :func:`tissueid.inference.window.fitted_log`
    unloading: bool = False  # true where samples after the tool first turned back take part
    #: The law whose surface is followed; ``None`` takes contact loss from the measured force.
    surface: FreeSurface | None = None
    hold_share: float = 1.0  # first share of every hold that takes part
    arrives: bool = False  # true where it is fitted as one that begins in motion
    follows_speed: bool = False  # the speed ratio along the log is measured, and samples at corners stay out

    def window(self, trial: Trial, segmentation: Segmentation, *, guard: bool = False) -> FittedLog | None:
        """The part of a trial that is fitted under a segmentation; ``None`` where there is none."""
        log = fitted_log(trial, segmentation, guard=guard, whole=self.unloading, surface=self.surface)
        if log is not None and self.follows_speed:
            return with_speed_ratio(trial, segmentation, log)
        return log

    def own_window(self, trial: Trial) -> FittedLog | None:
        """The part of its trial; as it is where the guard zone swallows a very shallow log."""
        guarded = self.window(trial, self.segmentation, guard=self.guard)
        return guarded or self.window(trial, self.segmentation)

    def fitted(self) -> tuple[Trial, FittedLog]:
        """The trial and its fitted part, loaded anew."""
        trial = self.load()
        log = self.own_window(trial)
        if log is None:
            raise RuntimeError(f"{trial.name} changed while it was being fitted")
        if self.hold_share < 1.0:
            log = with_holds_cut(log, self.segmentation.of_kind("hold"), self.hold_share)
        return trial, log


def blocks_of(handle: LogHandle, log: FittedLog, *, whole: bool = False) -> Blocks:
    """Blocks of the fitted part of a log; every sample of it where ``whole``."""
    contact = handle.segmentation.contact
    data = assign_folds(log, handle.segmentation.of_kind("hold"))
    in_air = contact is not None and contact.in_record and not (handle.unloading or handle.follows_speed)
    return log_blocks(
        data,
        step_s=log.step_s,
        contact_sd_mm=max(handle.contact_sd_mm, OFFSET_SD_FLOOR * log.depth_mm),
        leads=in_air or handle.arrives,
        whole=whole,
    )


def speed_handles(handles: Sequence[LogHandle], laws: Candidates) -> list[LogHandle]:
    """The same logs with their speed ratio where a law follows it: to their ends where each of them does.

    Raises InputError: a log has no contact that begins at a speed.
    """
    named = [*laws.laws, *([laws.paper] if laws.paper is not None else [])]
    if not any(one.damped for one in named):
        return list(handles)
    whole, out = all(one.damped for one in named), []
    for handle in handles:
        trial = handle.load()
        now = replace(handle, follows_speed=True, unloading=whole)
        log = now.own_window(trial)
        if log is None:
            none = f"0 contacts begin at a speed, of which {named[0].name!r} is a law"
            msg = f"{none}: record the approach, exclude the recording, or fit kelvin-voigt"
            raise InputError(NO_CONTACT, msg, path=trial.source.path, sheet=trial.source.sheet)
        # a power and a contact are told by the same samples: a segmenter that took the power for another has
        # placed the contact elsewhere
        out.append(replace(now, facts=log.without_samples(), contact_sd_mm=log.depth_mm))
    return out
