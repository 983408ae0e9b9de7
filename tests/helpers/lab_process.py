"""A virtual lab in a process of its own."""

from __future__ import annotations

import itertools
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from baggie.lab.web import LabControl
from baggie.workcell.workcell_file import read_workcell_file

ENDS_WITH_US = ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []
"""A pytest that is killed leaves no lab behind."""
_HOSTS = itertools.count(1)


@contextmanager
def running_lab(folder: Path, *words: str) -> Iterator[Path]:
    """The workcell file, in a folder, of a lab with small pictures that runs as fast as it can; it ends well."""
    path = folder / "cell.yaml"
    host = f"127.{next(_HOSTS)}.{os.getpid() % 250}.{os.getpid() // 250 % 250 + 1}"
    address = ["--host", host, "--camera-port", "0", "--pace", "0"]
    told = ["lab", *address, "--out", str(path), "--size", "640x480", *words]
    lab = subprocess.Popen(
        [*ENDS_WITH_US, sys.executable, "-m", "baggie", *told], stdout=subprocess.PIPE, text=True
    )
    assert lab.stdout is not None
    printed = lab.stdout.readline()
    assert printed.startswith("# The virtual lab")
    yield path
    lab.send_signal(signal.SIGINT)
    assert lab.wait(20) == 0


def control_of(file: Path) -> LabControl:
    """The control channel of the lab that a workcell file opens."""
    camera = read_workcell_file(file).camera
    assert camera is not None
    assert camera.source is not None
    return LabControl(camera.source)
