"""A network camera for tests: MJPEG over HTTP, which can hang, repeat itself, hang up and come back."""

from __future__ import annotations

import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np

from baggie.types import Image

SIZE = (128, 96)
BITS = 16


def picture_of(number: int) -> Image:
    """A picture with its number in it, as bright and dark columns, that survives JPEG."""
    bits = [(number >> bit) & 1 for bit in range(BITS)]
    row = np.repeat(np.array(bits, np.uint8) * 200 + 20, SIZE[0] // BITS)
    return np.repeat(np.tile(row, (SIZE[1], 1))[..., None], 3, axis=2)


def number_in(picture: Image) -> int:
    """The inverse of `picture_of`."""
    columns = picture.reshape(picture.shape[0], BITS, -1).mean(axis=(0, 2))
    return sum(int(value > 120) << bit for bit, value in enumerate(columns))


class MjpegServer:
    """`mode`: `run`, `repeat` (the same picture over and over), `hang` (connected, but nothing comes)."""

    def __init__(self, period_s: float = 0.03) -> None:
        self.mode = "run"
        self.period_s = period_s
        self.made_at: dict[int, float] = {}
        self.connections = 0
        self._number = 0
        self._server: ThreadingHTTPServer | None = None
        self.port = 0
        self.come_back()

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}/stream.mjpg"

    def come_back(self) -> None:
        """Listen, on the same port as before."""
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                outer._serve(self)

            def log_message(self, *args: object) -> None:
                """Nothing on the terminal."""

        self._up = True
        self._server = ThreadingHTTPServer(("127.0.0.1", self.port), Handler)
        self._server.daemon_threads = True
        self.port = self._server.server_port
        threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True).start()

    def repeat(self) -> None:
        """Make one more picture, and send that over and over."""
        self._number += 1
        self.mode = "repeat"

    def go_away(self) -> None:
        """Hang up on everybody and stop listening."""
        self._up = False
        assert self._server is not None
        self._server.shutdown()
        self._server.server_close()

    def _serve(self, request: BaseHTTPRequestHandler) -> None:
        server = self._server
        self.connections += 1
        request.send_response(200)
        request.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        request.end_headers()
        try:
            while self._up and server is self._server:
                if self.mode != "hang":
                    request.wfile.write(self._part())
                    request.wfile.flush()
                time.sleep(self.period_s)
        except OSError:
            return  # the camera hung up

    def _part(self) -> bytes:
        if self.mode == "run":
            self._number += 1
            self.made_at[self._number] = time.monotonic()
        jpeg = cv2.imencode(".jpg", picture_of(self._number))[1].tobytes()
        head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
        return head.encode() + jpeg + b"\r\n"
