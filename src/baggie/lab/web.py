"""The lab over HTTP: the camera's stream, a channel to know the truth, set the scene and cause faults, and its client.

GET  /camera.mjpg
GET  /truth
POST /reset?seed=3
POST /bag?x=0.5&y=0.1&yaw=0&undented=1&name=bag+2
POST /block?x=0.5&y=0&height=0.04
POST /paddle?shown=1
POST /fault?name=reflex&after=2.0&seconds=3.0
"""

from __future__ import annotations

import json
import logging
import math
import signal
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import asdict, replace
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

from baggie.errors import BaggieError
from baggie.files import write_text
from baggie.geometry import PlanarPose
from baggie.lab.faults import DEFAULT_S, LabCamera, cause, check_fault
from baggie.lab.lab import Lab
from baggie.options.commissioning import LabOptions
from baggie.registry import TASKS
from baggie.robot.limits import WORKSPACE
from baggie.tasks.conditions import State

_TIMEOUT_S = 60.0
_LOOK_S = 0.05
_ROW_M = 0.17
"""From bag to bag of those that are laid aside."""


class LabControl:
    """A lab at an address, such as `http://127.0.0.1:8090`; that of its camera's stream will do, too.

    Raises `BaggieError` when no lab answers, or when it refuses.
    """

    def __init__(self, address: str) -> None:
        parts = urlsplit(address)
        self.address = f"{parts.scheme}://{parts.netloc}"

    def truth(self) -> dict[str, Any]:
        """What only a simulation knows; see `baggie.lab.web.truth`."""
        return self._ask("GET", "truth")

    def state(self) -> State:
        """Where all bags truly are, as the conditions of a task judge it."""
        return State.of({name: _pose(bag).upright(bag["z"]) for name, bag in self.truth()["bags"].items()})

    def wait(self, seconds: float) -> None:
        """Return when so much of the lab's time has passed."""
        until = self.truth()["time"] + seconds
        while self.truth()["time"] < until:
            time.sleep(_LOOK_S)

    def bag_pose(self) -> PlanarPose:
        """The true centre and yaw of the bag, of several the first, robot base frame."""
        return _pose(self.truth()["bag"])

    def reset(self, seed: int) -> PlanarPose:
        """A new scene; where the bag, of several the first, lies in it. Not while the arm moves."""
        return _pose(self._ask("POST", "reset", seed=seed)["bag"])

    def lay_bag(self, pose: PlanarPose, *, name: str | None = None, undented: bool = False) -> None:
        """Put a bag, the first unless `name` says which, somewhere else; its dents stay unless `undented`."""
        which = {} if name is None else {"name": name}
        self._ask("POST", "bag", x=pose.x, y=pose.y, yaw=pose.yaw, undented=int(undented), **which)

    def lay_aside(self, pose: PlanarPose) -> None:
        """Put all bags somewhere else: the first there, the others in a row away from the robot's middle, along y."""
        for number, name in reversed([*enumerate(self.truth()["bags"])]):
            self.lay_bag(replace(pose, y=pose.y + math.copysign(_ROW_M, pose.y) * number), name=name)

    def lay_block(self, pose: PlanarPose, height_m: float) -> None:
        """Lay a firm block on the table for the arm to feel, beside the bag and below the hand."""
        self._ask("POST", "block", x=pose.x, y=pose.y, height=height_m)

    def take_block_away(self) -> None:
        """Take the firm block off the table."""
        self._ask("POST", "block", height=0)

    def show_paddle(self, shown: bool) -> None:
        """Put the calibration paddle into the hand, or take it away; see `baggie.workcell.workcell.Marker`."""
        self._ask("POST", "paddle", shown=int(shown))

    def fault(self, name: str, after: float = 0.0, seconds: float | None = None) -> None:
        """Let something of `baggie.lab.faults.FAULTS` go wrong, `after` seconds of the lab's time from now."""
        lasting = {} if seconds is None else {"seconds": seconds}
        self._ask("POST", "fault", name=name, after=after, **lasting)

    def _ask(self, method: str, path: str, **words: Any) -> dict[str, Any]:
        request = urllib.request.Request(f"{self.address}/{path}?{urlencode(words)}", method=method)
        try:
            with urllib.request.urlopen(request, timeout=_TIMEOUT_S) as answer:
                content: dict[str, Any] = json.load(answer)
                return content
        except urllib.error.HTTPError as error:
            raise BaggieError(json.load(error)["error"]) from None
        except OSError as error:
            raise BaggieError(
                f"no lab answers at {self.address} ({getattr(error, 'reason', error)}); start one with: baggie lab"
            ) from None


STREAM = "/camera.mjpg"
_BOUNDARY = "frame"
_LONGEST = 4096
"""Bytes of what is said in a form."""


class LabServer:
    """Serves a lab from threads of its own."""

    def __init__(self, lab: Lab, port: int) -> None:
        """Listens at once, at a free port if `port` is 0. Raises `BaggieError` where the port cannot be had."""
        self.camera = LabCamera(lab)
        try:
            self._server = _Server((lab.host, port), _Handler)
        except OSError as error:
            raise BaggieError(
                f"port {port} of {lab.host} cannot be had ({error.strerror}); give another --camera-port, or 0 for any"
            ) from None
        self._server.lab, self._server.camera = lab, self.camera
        self.address = f"http://{lab.host}:{self._server.server_port}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    lab: Lab
    camera: LabCamera

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that hangs up is no news."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: _Server

    def do_GET(self) -> None:
        path = urlsplit(self.path).path
        if path == STREAM:
            self._stream()
        elif path == "/truth":
            self._answer(HTTPStatus.OK, self.server.lab.call(lambda: truth(self.server.lab)))
        else:
            self._answer(HTTPStatus.NOT_FOUND, {"error": f"expected {STREAM} or /truth, got {path}"})

    def do_POST(self) -> None:
        lab, camera = self.server.lab, self.server.camera
        asked = urlsplit(self.path)
        try:
            words = _words(asked.query, self._form())
            match asked.path:
                case "/reset":
                    _check_known(words, "seed")
                    seed = _whole(words, "seed", lab.seed)
                    lab.call(lambda: lab.reset(seed))
                case "/bag":
                    _check_known(words, "x", "y", "yaw", "undented", "name")
                    pose = PlanarPose(_number(words, "x"), _number(words, "y"), _number(words, "yaw", 0.0))
                    undented = _whole(words, "undented", 0, most=1) == 1
                    name = words.get("name", lab.bags[0].name)
                    lab.call(lambda: lab.lay_bag(pose, name, undented=undented))
                case "/block":
                    _check_known(words, "x", "y", "height")
                    height = _number(words, "height")
                    at = PlanarPose(_number(words, "x", 0.0), _number(words, "y", 0.0))
                    lab.call(lambda: lab.lay_block(at, height))
                case "/paddle":
                    _check_known(words, "shown")
                    shown = _whole(words, "shown", most=1) == 1
                    lab.call(lambda: lab.world.show_paddle(shown))
                case "/fault":
                    _check_known(words, "name", "after", "seconds")
                    after, seconds = _number(words, "after", 0.0), _number(words, "seconds", DEFAULT_S)
                    lab.call(lambda: cause(words.get("name", ""), lab, camera, after, seconds))
                case other:
                    raise BaggieError(f"expected /reset, /bag, /block, /paddle or /fault, got {other}")
        except BaggieError as error:
            self._answer(HTTPStatus.BAD_REQUEST, {"error": str(error)})
        else:
            self._answer(HTTPStatus.OK, lab.call(lambda: truth(lab)))

    def _form(self) -> str:
        """What comes as a form sends it, `curl -d seed=3`, in place of the address."""
        length = self.headers.get("Content-Length", "0")
        if not (length.isdecimal() and int(length) <= _LONGEST):
            raise BaggieError(
                f"expected a form of at most {_LONGEST} bytes, got Content-Length {length[:20]!r}"
            )
        return self.rfile.read(int(length)).decode("latin-1")

    def log_message(self, *arguments: object) -> None:
        """Write nothing on the terminal."""

    def _answer(self, status: HTTPStatus, content: dict[str, Any]) -> None:
        body = json.dumps(content).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _stream(self) -> None:
        if not self.server.camera.is_there:
            self._answer(HTTPStatus.SERVICE_UNAVAILABLE, {"error": "the camera is unplugged"})
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
        self.end_headers()
        try:
            for jpeg in self.server.camera.frames():
                head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                self.wfile.write(head.encode() + jpeg + b"\r\n")
        except (OSError, EOFError):
            pass  # the client hung up, or the lab is closed


def truth(lab: Lab) -> dict[str, Any]:
    """What only a simulation knows: metres, radians, in the robot's base frame; seconds of the lab's own time.

    `z` of a bag is the mean height of its surface; `bag` is the first of `bags`.
    """
    bodies, first = lab.world.bodies, lab.bags[0].name
    bags = {
        name: {**asdict(body.planar_pose()), "z": float(body.pose()[2, 3])} for name, body in bodies.items()
    }
    return {
        "seed": lab.seed,
        "time": lab.time,
        "bag": bags[first],
        "bag_lowest_z": bodies[first].bottom_m(),
        "bags": bags,
        "block": {"height": lab.world.block.height_m, "pressed_n": lab.world.block.pressed_n},
        "tool": dict(zip("xyz", lab.robot.tool_xyz, strict=True)),
        "gripper_width": lab.robot.hand.width,
        "motions_begun": lab.fci.begun,
        "errors_recovered": lab.fci.recovered,
    }


def _pose(bag: dict[str, float]) -> PlanarPose:
    """Of a bag in `truth`."""
    return PlanarPose(bag["x"], bag["y"], bag["yaw"])


def _words(*texts: str) -> dict[str, str]:
    """What is said as `NAME=VALUE&NAME=VALUE`, each once."""
    pairs = [pair for text in texts for pair in parse_qsl(text, keep_blank_values=True)]
    words = dict(pairs)
    if len(words) < len(pairs):
        raise BaggieError(f"expected each of {' and '.join(words)} once, got one of them twice")
    return words


def _check_known(words: dict[str, str], *known: str) -> None:
    for name in words.keys() - set(known):
        raise BaggieError(f"expected {' and '.join(known)}, got {name!r}")


def _number(words: dict[str, str], name: str, default: float | None = None) -> float:
    """A finite one."""
    if name not in words and default is not None:
        return default
    try:
        if math.isfinite(number := float(words[name])):
            return number
    except (KeyError, ValueError):
        pass
    raise BaggieError(f"expected a number as {name}, got {words.get(name, 'none')!r}")


def _whole(words: dict[str, str], name: str, default: int | None = None, most: int | None = None) -> int:
    """A whole number of at least 0."""
    if name not in words and default is not None:
        return default
    try:
        number = int(words[name])
        if number >= 0 and (most is None or number <= most):
            return number
    except (KeyError, ValueError):
        pass
    bounds = "of at least 0" if most is None else f"from 0 to {most}"
    raise BaggieError(f"expected a whole number {bounds} as {name}, got {words.get(name, 'none')!r}")


_FILE = """\
# The virtual lab: a simulated workcell behind the interfaces of a real one (docs/lab.md).
arm:
  kind: franka
  host: {host}
  realtime: false
  speed: 1.0
camera:
  source: {camera}
  timeout_s: 20
{workspace}bag:
  length_m: {bag.length_m}
  width_m: {bag.width_m}
  color: {color}
"""
_WORKSPACE = """\
workspace:
  x: [{area.x_min}, {area.x_max}]
  y: [{area.y_min}, {area.y_max}]
"""


def _print(text: str) -> None:
    print(text, flush=True)


def serve_lab(options: LabOptions, announce: Callable[[str], None] = _print) -> None:
    """Keep a lab going until Ctrl-C, or until the process is told to end. `announce` gets the workcell file's text.

    Raises `BaggieError` where an address cannot be had, or a fault is not one.
    """
    options.check()
    for name, after_s in options.faults():
        check_fault(name, after_s)
    logging.getLogger("franky_sim").setLevel(logging.CRITICAL)  # a client that hangs up is no news
    lab = Lab(
        TASKS[options.task],
        options.cell,
        seed=options.seed,
        host=options.host,
        pace=options.pace,
        picture_size=options.picture_size(),
    )
    server = LabServer(lab, options.camera_port)
    for name, after_s in options.faults():
        cause(name, lab, server.camera, after_s)
    text = workcell_text(lab, server)
    if options.out is not None:
        write_text(options.out, text)
    announce(text)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: lab.close())
    lab.run()
    server.close()


def workcell_text(lab: Lab, server: LabServer) -> str:
    """The workcell file that opens the lab."""
    bag, area = lab.bags[0], lab.task.workspace
    return _FILE.format(
        host=lab.host,
        camera=server.address + STREAM,
        workspace="" if area == WORKSPACE else _WORKSPACE.format(area=area),
        bag=bag,
        color=[*bag.color],
    ) + (f"  colors: {[[*each.color] for each in lab.bags]}\n" if len(lab.bags) > 1 else "")
