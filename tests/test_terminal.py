"""Whether a person is at the terminal."""

import io
import os
import subprocess
import sys

import pytest
from rich.console import Console

from baggie.progress import ask, is_attended

pty = pytest.importorskip("pty", reason="terminals are told apart on POSIX only")
PROGRAM = """
import fcntl, os, termios
from baggie.progress import is_attended
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
print(is_attended(), flush=True)
if os.fork() == 0:
    os.setpgrp()
    print(is_attended(), flush=True)
    os._exit(0)
os.wait()
"""


def test_it_is_attended_in_the_foreground_of_a_terminal_only():
    ours, theirs = pty.openpty()
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(
        command, stdin=theirs, capture_output=True, text=True, start_new_session=True, check=True
    )
    os.close(ours), os.close(theirs)
    assert done.stdout.split() == ["True", "False"]


@pytest.mark.parametrize("stdin", [None, io.StringIO("yes\n")])
def test_nobody_is_there_without_a_terminal(monkeypatch, stdin):
    monkeypatch.setattr(sys, "stdin", stdin)
    assert not is_attended()


def test_a_question_is_shown_as_it_is_and_answered_up_to_enter(monkeypatch):
    shown = io.StringIO()
    monkeypatch.setattr(sys, "stdin", io.StringIO(" 1 -0.5 \nmore"))
    assert ask(Console(file=shown), "how far is [it] off?") == "1 -0.5"
    assert shown.getvalue() == "→ how far is [it] off? "
