"""Libraries of the operating system, which pip does not bring: one list, and each is tried instead of looked up.

`make` runs this file before it downloads anything, with whatever Python the machine has, so it needs nothing but the
standard library.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial


@dataclass(frozen=True)
class Need:
    """Something the machine has to have."""

    name: str
    """What it is on any machine."""
    package: str
    """What brings it, on Debian and its relatives."""
    there: Callable[[], bool]
    """Tries it."""


def _loads(*names: str) -> bool:
    """Whether one of these libraries can be loaded."""
    for name in names:
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return True
    return False


def _opens_display() -> bool:
    """Whether EGL opens a display on one of the machine's devices, as MuJoCo does: a driver is no library to load."""
    os.environ.setdefault("EGL_LOG_LEVEL", "fatal")  # what fails is said here, in one line
    pointer = ctypes.c_void_p
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return False
    egl.eglGetProcAddress.restype = pointer
    query, get = map(egl.eglGetProcAddress, (b"eglQueryDevicesEXT", b"eglGetPlatformDisplayEXT"))
    if not query or not get:
        return False
    devices, count = (pointer * 32)(), ctypes.c_int()
    ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, pointer, pointer)(query)(
        len(devices), ctypes.addressof(devices), ctypes.addressof(count)
    )
    display_of = ctypes.CFUNCTYPE(pointer, ctypes.c_uint, pointer, pointer)(get)
    egl.eglInitialize.argtypes = [pointer] * 3
    displays = (display_of(_EGL_PLATFORM_DEVICE, device, None) for device in devices[: count.value])
    return any(display and egl.eglInitialize(display, None, None) for display in displays)


_EGL_PLATFORM_DEVICE = 0x313F


def _library(name: str, package: str, *instead: str) -> Need:
    """A library, or others that do as well."""
    return Need(name, package, partial(_loads, name, *instead))


_EGL = _library("libEGL.so.1", "libegl1")
_DRIVER = Need("an OpenGL driver for EGL, as Mesa has", "libgl1-mesa-dri", _opens_display)
_OPENGL = _library("libOpenGL.so.0", "libopengl0", "libGL.so.1")
_OSMESA = _library("libOSMesa.so.8", "libosmesa6", "libOSMesa.so.6")
_OPENMP = _library("libgomp.so.1", "libgomp1")  # pinocchio, behind franky-sim: the server of the virtual lab
_USB = _library("libusb-1.0.so.0", "libusb-1.0-0")  # pyrealsense2
_VENV = Need(
    "Python's own venv",
    f"python{sys.version_info[0]}.{sys.version_info[1]}-venv",
    lambda: importlib.util.find_spec("ensurepip") is not None,
)

RENDERING = {"egl": (_EGL, _DRIVER, _OPENGL), "osmesa": (_OSMESA,)}
"""By MuJoCo's name of each way to render off screen: what it takes."""


def rendering_backend(names: Iterable[str] = RENDERING) -> str | None:
    """The first of these ways to render off screen whose libraries can be loaded; that opens no display yet."""
    libraries = {name: [need for need in RENDERING[name] if need is not _DRIVER] for name in names}
    return next((name for name, needs in libraries.items() if not missing(needs)), None)


def missing(needs: Iterable[Need]) -> list[Need]:
    """Find the needs that are not there."""
    return [need for need in needs if not need.there()]


def missing_for_rendering() -> list[Need]:
    """What is not there for rendering off screen; nothing on systems where MuJoCo brings or finds its own way."""
    return missing(RENDERING[rendering_backend() or "egl"]) if sys.platform == "linux" else []


def missing_for_all() -> list[Need]:
    """What is not there for building the environment and running everything in it, tests too."""
    libraries = missing((_OPENMP, _USB)) if sys.platform == "linux" else []
    return [*missing_for_rendering(), *libraries, *missing([_VENV])]


def remedy(needs: Iterable[Need]) -> str:
    """What to do so that these are there, as part of a line."""
    needs = list(needs)
    if shutil.which("apt-get"):
        return f"sudo apt-get install {' '.join(need.package for need in needs)}"
    return f"install {', '.join(need.name for need in needs)} with the system's own package manager"


def providers(text: str) -> Iterator[Need]:
    """What brings the libraries that are named in an error message."""
    known = (*(need for needs in RENDERING.values() for need in needs), _OPENMP, _USB)
    return (need for need in known if need.name in text)


def _install(needs: Iterable[Need]) -> None:
    """Install packages as root, on Debian and its relatives."""
    packages = [need.package for need in needs]
    print("installing what pip cannot:", *packages, flush=True)
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    for words in (["update"], ["install", "-y", "--no-install-recommends", *packages]):
        subprocess.run(["apt-get", "-qq", *words], check=False, stdout=subprocess.DEVNULL, env=environment)


def main(may_install: bool) -> int:
    """Install what is missing where that is allowed; else one line says how. The exit status."""
    needs = missing_for_all()
    if not needs:
        return 0
    if may_install and os.geteuid() == 0 and shutil.which("apt-get"):
        _install(needs)
        # In a process of its own: what a library found when it was loaded stays so within one.
        return subprocess.run([sys.executable, "-I", __file__, "--only-look"], check=False).returncode
    names = ", ".join(need.name for need in needs)
    print(f"error: this machine lacks what pip cannot install ({names}): {remedy(needs)}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main(may_install="--only-look" not in sys.argv))
