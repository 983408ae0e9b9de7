"""The process of `fci_server.py`, and what it is told."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


class Server:
    """The server's process."""

    def __init__(self, *addresses: str) -> None:
        self.start(*addresses)

    def start(self, *addresses: str) -> None:
        """Listen at the first address that is free."""
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("fci_server.py")), *addresses],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        self.host = self._answer()

    def tell(self, command: str) -> None:
        assert self._process.stdin
        self._process.stdin.write(command + "\n")

    def count(self) -> tuple[int, int]:
        """Motions begun and recoveries from errors so far."""
        self.tell("count")
        begun, recovered = self._answer().split()
        return int(begun), int(recovered)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def _answer(self) -> str:
        assert self._process.stdout
        return self._process.stdout.readline().strip()
