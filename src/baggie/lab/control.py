"""A program's side of the lab's control channel: know the truth, set the scene, let things go wrong."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from typing import Any
from urllib.parse import urlencode, urlsplit

from baggie.errors import BaggieError
from baggie.geometry import PlanarPose

_TIMEOUT_S = 60.0


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

    def bag_pose(self) -> PlanarPose:
        """The bag's true centre and yaw, robot base frame."""
        bag = self.truth()["bag"]
        return PlanarPose(bag["x"], bag["y"], bag["yaw"])

    def reset(self, seed: int) -> PlanarPose:
        """A new scene; where the bag lies in it. Not while the arm moves."""
        bag = self._ask("POST", "reset", seed=seed)["bag"]
        return PlanarPose(bag["x"], bag["y"], bag["yaw"])

    def lay_bag(self, pose: PlanarPose, *, undented: bool = False) -> None:
        """Put the bag somewhere else; the dents that grasps left in it stay unless `undented`."""
        self._ask("POST", "bag", x=pose.x, y=pose.y, yaw=pose.yaw, undented=int(undented))

    def lay_block(self, pose: PlanarPose, height_m: float) -> None:
        """Lay a firm block on the table for the arm to feel, beside the bag and below the hand."""
        self._ask("POST", "block", x=pose.x, y=pose.y, height=height_m)

    def take_block_away(self) -> None:
        """Off the table."""
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
