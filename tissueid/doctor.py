"""Abilities of this machine with tissueid, and obstacles: a line a check, each with a way out."""

from __future__ import annotations

import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import requires

from tissueid import __version__
from tissueid.extras import EXTRA_OF, installed, versions
from tissueid.own_process import own_process

#: Seconds that a probe in a process of its own may take.
PATIENCE_S = 60.0
#: Memory below which a large cohort is slow [GB].
LITTLE_MEMORY_GB = 2.0


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that was looked at."""

    name: str
    #: {"ok", "note", "missing"}: ``note`` costs time or comfort, ``missing`` something that does not work
    #: without it.
    state: str
    words: str
    way_out: str | None = None  # what to type or do


def examine() -> Iterator[Check]:
    """Look at everything, one check at a time."""
    looks = (_program, _machine, _libraries, _extras, _loop, _real_time, _devices, _page, _browser)
    yield from (look() for look in looks)


def _program() -> Check:
    return Check("tissueid", "ok", f"{__version__}, Python {platform.python_version()} at {sys.executable}")


def _machine() -> Check:
    words = f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors"
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    except (AttributeError, ValueError, OSError):
        return Check("machine", "ok", words)
    words = f"{words}, {memory:.1f} GB of memory"
    if memory < LITTLE_MEMORY_GB:
        return Check("machine", "note", words, "fit large cohorts with --workers 1")
    return Check("machine", "ok", words)


def _libraries() -> Check:
    lines = [line for line in requires("tissueid") or () if "extra ==" not in line]
    names = [re.findall(r"[\w.-]+", line)[0] for line in lines]
    found = versions(names)
    missing = [name for name in names if name not in found]
    if missing:
        lost = ", ".join(missing)
        return Check("libraries", "missing", f"not installed: {lost}", f"pip install {' '.join(missing)}")
    return Check("libraries", "ok", _listed(found))


def _listed(found: dict[str, str]) -> str:
    return ", ".join(f"{name} {version}" for name, version in found.items())


def _extras() -> Check:
    found = versions(EXTRA_OF)
    words = _listed(found) or "none"
    wanted = ",".join(dict.fromkeys(extra for module, extra in EXTRA_OF.items() if module not in found))
    if wanted:
        return Check("extras", "note", words, f"where wanted: pip install 'tissueid[{wanted}]'")
    return Check("extras", "ok", words)


def _loop() -> Check:
    if sys.platform == "win32":
        return Check("servo loop", "missing", "rendering needs Linux")
    if not installed("numba"):
        return Check("servo loop", "missing", "numba is not installed", "pip install 'tissueid[haptics]'")
    from tissueid.rendering.first_start import is_compiled

    if is_compiled():
        return Check("servo loop", "ok", "compiled")
    return Check("servo loop", "note", "the first `tissueid render` runs uncompiled while it compiles",
                 "tissueid doctor --warm")  # fmt: skip


def _real_time() -> Check:
    """Scheduling that a servo would be granted, asked by a process of its own."""
    if not sys.platform.startswith("linux"):
        return Check(
            "real time", "note", "no real-time scheduling on this system; the servo says its periods"
        )
    try:
        told = subprocess.run(  # noqa: S603 -- our own interpreter and module
            own_process("tissueid.rendering.servo_schedule"),
            capture_output=True,
            check=True,
            timeout=PATIENCE_S,
        )
        schedule = json.loads(told.stdout)
    except (OSError, subprocess.SubprocessError, ValueError) as error:
        return Check("real time", "note", f"could not be asked ({type(error).__name__})",
                     "tissueid render --selftest")  # fmt: skip
    words = f"{schedule['name']}, memory {'locked' if schedule['locked'] else 'not locked'}"
    if schedule["remedies"]:
        return Check("real time", "note", words, "; ".join(schedule["remedies"]))
    return Check("real time", "ok", words)


def _devices() -> Check:
    from tissueid.haptics.registry import choose_device, detect_all

    found = [f"{one.name} at {one.where}" + (f" ({one.note})" if one.note else "") for one in detect_all()]
    return Check("devices", "ok", f"{'; '.join(found) or 'none'}; {choose_device().why}")


def _page() -> Check:
    from tissueid.viewer.bundling import BUNDLE

    if (BUNDLE / "index.html").is_file():
        return Check("viewer page", "ok", "built")
    return Check("viewer page", "missing", "not built when this was installed: no node, or no registry",
                 "python -m tissueid.viewer.bundling")  # fmt: skip


def _browser() -> Check:
    import webbrowser

    try:
        name = webbrowser.get().__class__.__name__
    except webbrowser.Error:
        return Check("browser", "note", "none was found: addresses of the viewer are printed",
                     "open them on another machine, with --host")  # fmt: skip
    return Check("browser", "ok", f"addresses are opened by {name}")


def warm(tell: Callable[[str], None]) -> None:
    """Compile everything now: a small synthetic specimen is fitted, and the servo's loop is built."""
    import numpy as np

    from tissueid.inference.posterior import PosteriorOptions
    from tissueid.inference.specimen import FitOptions
    from tissueid.pipeline import IdentifyOptions, identify
    from tissueid.synth.recipe import recipe
    from tissueid.synth.simulate import as_trials, simulate

    tell("compiling what a fit needs")
    trials = as_trials(simulate(recipe("paper-a-30-10Hz"), rng=np.random.default_rng(0)))
    for noise in ("white", "auto"):
        options = IdentifyOptions(fit=FitOptions(noise=noise), posterior=PosteriorOptions(draws=1000))
        identify(trials, options=options)
    if sys.platform != "win32" and installed("numba"):
        from tissueid.rendering.first_start import compile_loop

        tell("compiling the servo's loop")
        compile_loop()
