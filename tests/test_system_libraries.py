"""What the machine lacks is found by trying it, and said in one line, before anything is downloaded or drawn."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

import baggie
from baggie import gl, system_libraries
from baggie.cameras import open_camera
from baggie.cameras.camera import CameraSettings
from baggie.errors import BaggieError, CameraError, explained
from baggie.robot.franka.link import load_franky

SOURCE = Path(baggie.__file__).parents[1]
SCRIPT = SOURCE / "baggie" / "system_libraries.py"
EVERYTHING = "libEGL.so.1 driver libOpenGL.so.0 libgomp.so.1 libusb-1.0.so.0"


@ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.POINTER(ctypes.c_int))
def one_device(_room: int, _devices: object, count: Any) -> int:
    count[0] = 1
    return 1


@ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p)
def its_display(*_: object) -> int:
    return 1


class Machine:
    """A Debian machine on which one is no administrator, with these libraries and nothing else."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.has: list[str] = []
        self.apt_get: list[str] = []
        monkeypatch.setattr(sys, "platform", "linux")
        monkeypatch.setattr(ctypes, "CDLL", self.load)
        monkeypatch.setattr(os, "geteuid", lambda: 1000)
        monkeypatch.setattr(system_libraries.shutil, "which", lambda name: f"/usr/bin/{name}")
        for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM"):  # and as they were afterwards
            monkeypatch.setenv(name, "")

    def load(self, name: str) -> Mock:
        if name not in self.has:
            raise OSError(f"{name}: cannot open shared object file: No such file or directory")
        functions = {b"eglQueryDevicesEXT": one_device, b"eglGetPlatformDisplayEXT": its_display}
        library = Mock()
        library.eglGetProcAddress.side_effect = lambda function: (
            ctypes.cast(functions[function], ctypes.c_void_p).value
        )
        library.eglInitialize.side_effect = lambda *_: "driver" in self.has
        return library


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    return Machine(monkeypatch)


@pytest.mark.parametrize(
    ("has", "packages"),
    [
        ("", "libegl1 libgl1-mesa-dri libopengl0 libgomp1 libusb-1.0-0"),
        ("libgomp.so.1 libusb-1.0.so.0", "libegl1 libgl1-mesa-dri libopengl0"),
        ("libEGL.so.1 libgomp.so.1 libusb-1.0.so.0", "libgl1-mesa-dri libopengl0"),  # as make once left it
        ("libEGL.so.1 libOpenGL.so.0 libgomp.so.1 libusb-1.0.so.0", "libgl1-mesa-dri"),
        ("libEGL.so.1 libGL.so.1 driver", "libgomp1 libusb-1.0-0"),  # libGL does as well
        ("libOSMesa.so.8 libusb-1.0.so.0", "libgomp1"),  # which renders too
    ],
)
def test_one_line_names_the_one_command_that_brings_all_that_is_missing(
    has: str, packages: str, machine: Machine, capsys: pytest.CaptureFixture[str]
) -> None:
    machine.has = has.split()
    assert system_libraries.main(may_install=True) == 1
    said = capsys.readouterr()
    (line,) = said.err.splitlines()
    assert said.out == ""
    assert line.startswith("error: ")
    assert line.endswith(f": sudo apt-get install {packages}")


def test_where_everything_is_there_nothing_is_said(
    machine: Machine, capsys: pytest.CaptureFixture[str]
) -> None:
    machine.has = EVERYTHING.split()
    assert system_libraries.main(may_install=True) == 0
    assert capsys.readouterr() == ("", "")


def test_without_venv_its_package_is_in_the_same_command(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ensurepip", None)
    monkeypatch.setattr(system_libraries.importlib.util, "find_spec", lambda _: None)
    assert system_libraries.main(may_install=True) == 1
    version = ".".join(map(str, sys.version_info[:2]))
    assert capsys.readouterr().err.endswith(f" libusb-1.0-0 python{version}-venv\n")


def test_without_apt_get_the_libraries_are_named(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    machine.has = ["libusb-1.0.so.0", "libEGL.so.1", "driver"]
    monkeypatch.setattr(system_libraries.shutil, "which", lambda _: None)
    assert system_libraries.main(may_install=True) == 1
    assert "install libOpenGL.so.0, libgomp.so.1 with the system's own package" in capsys.readouterr().err


def test_root_has_them_installed_and_looks_again_in_a_new_process(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = []

    def run(words: list[str], **_: object) -> Mock:
        ran.append(words)
        return Mock(returncode=7)

    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(system_libraries.subprocess, "run", run)
    machine.has = ["libEGL.so.1", "driver", "libOpenGL.so.0"]
    assert system_libraries.main(may_install=True) == 7
    assert ran[1][-2:] == ["libgomp1", "libusb-1.0-0"]
    assert ran[2][-1] == "--only-look"


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make: sudo apt-get install make")
@pytest.mark.parametrize("target", ["test", "demo"])
def test_make_looks_before_it_downloads(target: str) -> None:
    words = ["make", "--dry-run", "VENV=nowhere", target]
    plan = subprocess.run(words, cwd=SOURCE.parent, capture_output=True, text=True, check=True).stdout
    steps = (
        "-I src/baggie/system_libraries.py",
        "pip install",
        {"test": "-m pytest", "demo": "demo.py"}[target],
    )
    places = [plan.index(step) for step in steps]
    assert places == sorted(places)


def test_the_page_on_installing_names_the_same(machine: Machine, capsys: pytest.CaptureFixture[str]) -> None:
    system_libraries.main(may_install=False)
    command = capsys.readouterr().err.split(": ")[-1]
    page = SOURCE.parent / "docs" / "installing.md"
    assert f"\n{command}" in page.read_text()


def test_it_runs_on_a_python_without_any_package_and_finds_all_here() -> None:
    done = subprocess.run(
        [sys.executable, "-I", "-S", SCRIPT, "--only-look"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.skipif(
    sys.platform != "linux", reason="runs on Linux alone: only there EGL has drivers to be without"
)
def test_a_driver_that_is_not_there_is_noticed_in_one_line() -> None:
    nowhere = {**os.environ, "__EGL_VENDOR_LIBRARY_DIRS": "/nowhere", "MUJOCO_GL": ""}
    done = subprocess.run(
        [sys.executable, "-I", SCRIPT, "--only-look"],
        env=nowhere,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "libgl1-mesa-dri" in done.stderr


def test_the_simulator_asks_the_same_list_before_it_draws(machine: Machine) -> None:
    machine.has = ["libEGL.so.1", "driver"]
    with pytest.raises(BaggieError, match=r"needs libOpenGL\.so\.0, .*: sudo apt-get install libopengl0$"):
        gl.require_backend()
    machine.has.append("libOpenGL.so.0")
    gl.require_backend()


@pytest.mark.parametrize(
    ("has", "chosen", "backend"),
    [
        ("libEGL.so.1 libOpenGL.so.0", "", "egl"),
        ("libEGL.so.1 libOSMesa.so.8", "", "osmesa"),
        ("libEGL.so.1 libOpenGL.so.0 libOSMesa.so.8", "osmesa", "osmesa"),
        ("libOSMesa.so.8", "egl", "disable"),
        ("libEGL.so.1", "", "disable"),  # MuJoCo would end the import with a traceback
        ("", "glfw", "glfw"),
    ],
)
def test_mujoco_is_told_what_there_is(
    has: str, chosen: str, backend: str, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine.has = has.split()
    monkeypatch.setenv("MUJOCO_GL", chosen)
    gl.choose_backend()
    assert os.environ["MUJOCO_GL"] == backend


def test_who_forbids_pictures_is_told_so_where_one_is_wanted(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine.has = EVERYTHING.split()
    monkeypatch.setenv("MUJOCO_GL", "disable")
    with pytest.raises(BaggieError, match="MUJOCO_GL=disable forbids"):
        gl.require_backend()


WITHOUT_OPENGL = """
import ctypes

class Without(ctypes.CDLL):
    def __init__(self, name, *arguments, **options):
        if name and name.startswith(("libEGL", "libOpenGL", "libGL.", "libOSMesa")):
            raise OSError(f"{name}: cannot open shared object file: No such file or directory")
        super().__init__(name, *arguments, **options)

ctypes.CDLL = Without
"""


@pytest.mark.skipif(
    sys.platform != "linux", reason="runs on Linux alone: elsewhere MuJoCo draws in other ways"
)
@pytest.mark.parametrize(
    "command",
    [
        ["collect", "--attempts", "1", "--out", "collected"],
        pytest.param(
            ["evaluate", "--policy", "oracle", "--episodes", "1", "--out", "x"], marks=pytest.mark.slow
        ),
        pytest.param(["lab"], marks=pytest.mark.slow),
    ],
    ids=lambda command: command[0],
)
def test_without_opengl_a_command_says_so_in_one_line(command: list[str], tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(WITHOUT_OPENGL)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (tmp_path, SOURCE))), "MUJOCO_GL": ""}
    done = subprocess.run(
        [sys.executable, "-m", "baggie", *command],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("error:")]
    assert line.startswith("error: rendering off screen needs libEGL.so.1, ")
    assert "libopengl0" in line or "libOpenGL.so.0" in line


def test_a_package_without_its_library_is_told_by_the_library(
    tmp_path: Path, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    for package, library in (("pyrealsense2", "libusb-1.0.so.0"), ("franky", "libgomp.so.1")):
        (tmp_path / f"{package}.py").write_text(
            f"raise ImportError('{library}: cannot open shared object file: No such file or directory')"
        )
        monkeypatch.delitem(sys.modules, package, raising=False)
    with pytest.raises(CameraError, match=r"libusb-1\.0\.so\.0 .*: sudo apt-get install libusb-1\.0-0$"):
        open_camera(CameraSettings(kind="realsense"))
    with pytest.raises(BaggieError, match=r"libgomp\.so\.1 .*: sudo apt-get install libgomp1$"):
        load_franky()


def test_any_other_import_that_fails_stays_a_fault() -> None:
    assert explained(ImportError("cannot import name 'x' from 'y'", name="y")) is None


@pytest.mark.parametrize("checked", [True, False])
def test_a_test_without_its_library_says_why_and_fails_only_where_everything_can_be(
    checked: bool, tmp_path: Path
) -> None:
    for package in ("pyrealsense2", "pyk4a"):
        (tmp_path / f"{package}.py").write_text(
            "raise ImportError('libusb-1.0.so.0: cannot open shared object file')"
        )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (tmp_path, SOURCE)))}
    environment["NO_SKIPS"] = "yes" if checked else ""
    files = ["tests/test_camera_realsense.py", "tests/test_camera_k4a.py"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", f"--basetemp={tmp_path / 'base'}", *files],
        cwd=SOURCE.parent, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "2 skipped" in done.stdout
    assert "sudo apt-get install libusb-1.0-0" in done.stdout
    assert "Azure Kinect Sensor SDK" in done.stdout
    complaint = "skipped, though everything can be here: tests/test_camera_realsense.py"
    assert (complaint in done.stdout) == checked
    assert "though everything can be here: tests/test_camera_k4a.py" not in done.stdout
    assert (done.returncode == pytest.ExitCode.TESTS_FAILED) == checked
