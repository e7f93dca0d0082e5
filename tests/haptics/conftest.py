"""Shared libraries that tests compile from C, and two stand-ins: libusb and the Force Dimension SDK."""

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parent
STRICT = ("-O1", "-Wall", "-Werror")


def compiled(source: Path, folder: Path, *options: str) -> Path:
    """Path of the shared library made of a source; the test is skipped, visibly, without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip(f"no C compiler (gcc or cc) to make {source.name} with")
    library = folder / f"{source.stem}.so"
    command = [compiler, "-shared", "-fPIC", "-o", library, source, *(options or STRICT), "-lm"]
    subprocess.run(command, check=True)
    return library


class UsbStub:
    """The stand-in for libusb: what it was asked, and how it behaves."""

    def __init__(self, library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.library, self._environment = ctypes.CDLL(str(library)), monkeypatch
        self.library.stub_record.restype = ctypes.c_char_p
        monkeypatch.setenv("TISSUEID_LIBUSB", str(library))
        monkeypatch.delenv("FALCON_STUB", raising=False)

    @property
    def lines(self) -> list[str]:
        text: bytes = self.library.stub_record()
        return text.decode("ascii").splitlines()

    def mode(self, word: str) -> None:
        # it reads its own process's environment
        self._environment.setenv("FALCON_STUB", word)
        self.library.stub_clear()


class SdkStub:
    """The stand-in for the Force Dimension SDK: the numbers inside it."""

    def __init__(self, library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.library = ctypes.CDLL(str(library))
        monkeypatch.setenv("TISSUEID_FORCEDIM", str(library))
        for name in ("homed", "fails", "stopped", "code", "buttons"):
            self[name] = 0
        self["major"] = 3

    def _at(self, name: str) -> Any:
        kinds = {"position": ctypes.c_double * 3, "force": ctypes.c_double * 3, "max_force": ctypes.c_double}
        return kinds.get(name, ctypes.c_int).in_dll(self.library, f"stub_{name}")

    def __getitem__(self, name: str) -> Any:
        found = self._at(name)
        return list(found) if isinstance(found, ctypes.Array) else found.value

    def __setitem__(self, name: str, value: int) -> None:
        self._at(name).value = value

    def move(self, *position_m: float) -> None:
        self._at("position")[:] = position_m


@pytest.fixture(scope="session")
def c_library() -> Callable[..., Path]:
    """Makes a shared library of a source, in a folder, with options of the compiler."""
    return compiled


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Makes the shared library of a name, once."""
    folder = tmp_path_factory.mktemp("libraries")
    made: dict[str, Path] = {}
    return lambda name: made.get(name) or made.setdefault(name, compiled(FOLDER / f"{name}.c", folder))


@pytest.fixture
def usb(library: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch) -> UsbStub:
    return UsbStub(library("usb_stub"), monkeypatch)


@pytest.fixture
def sdk(library: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch) -> SdkStub:
    return SdkStub(library("dhd_stub"), monkeypatch)
