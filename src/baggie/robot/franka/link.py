"""The link to a Franka robot: how it is found, what its errors mean, how it gets going again after one."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from baggie.errors import ArmError, BaggieError, ReachError, StuckError, explained, install_extra, pip_install
from baggie.geometry import FloatArray, difference, rigid
from baggie.robot.franka.models import TOOL_OFFSET_M

CONNECT_TIMEOUT_S = 10.0  # libfranka itself waits a minute for a robot that is not there
CONNECT_TRIES = 3
RETRY_PAUSE_S = 0.5
RECOVERIES = 3
"""How often the robot's automatic error recovery is tried after one error."""
IDLE_WITHIN_S = 2.0
"""After it has recovered."""
REFLEX_FORCE_N = 60.0
REFLEX_TORQUES_NM = [40.0, 40.0, 36.0, 36.0, 32.0, 28.0, 24.0]
"""A contact harder than these is a reflex: the robot stops by itself. Twice those of libfranka's examples, so that
pressing as hard as the workcell's limits allow is none."""
COLLISIONS = {"cartesian_reflex", "joint_reflex"}
HICCUPS = {"communication_constraints_violation"}
"""A packet came too late: nothing was touched, and the motion may be tried again."""
WHEELS = "https://timschneider42.github.io/franky/whl/by-robot-server-version"

_S = np.sqrt(0.5)
T_FLANGE_TOOL = rigid([[_S, _S, 0], [-_S, _S, 0], [0, 0, 1]], [0, 0, TOOL_OFFSET_M])
"""Of Franka's hand, as Desk sets it: its x axis is turned by -45 degrees from the flange's."""


class HiccupError(ReachError):
    """A motion was cut short because packets were late; the robot has recovered."""


class CollisionError(ReachError):
    """A motion was cut short by a contact harder than a reflex allows; the robot has recovered."""


def load_franky() -> Any:
    """The library that speaks with Franka robots. Raises `BaggieError` where it is not installed."""
    try:
        import franky  # noqa: PLC0415 -- an extra
    except ImportError as error:
        raise explained(error) or BaggieError(
            f"a Franka arm needs franky-control, which is not installed: {install_extra('franka')}"
        ) from None
    return franky


class FrankaLink:
    """One robot at one address. Connects when it is first needed, and again when the link was lost.

    Raises `ArmError` for whatever the robot or the network answers, in one line with what to do; `StuckError` where
    that takes a person.
    """

    def __init__(self, host: str, realtime: bool) -> None:
        self.host = host
        self._franky = load_franky()
        config = self._franky.RealtimeConfig
        self._realtime = config.Enforce if realtime else config.Ignore
        self._robot: Any = None
        self._gripper: Any = None
        self._unrecovered = ""
        """The errors that ended a motion and are there still."""

    @property
    def robot(self) -> Any:
        """The connected `franky.Robot`."""
        if self._robot is None:
            self._connect()
        return self._robot

    @property
    def gripper(self) -> Any:
        """The connected `franky.Gripper`, homed."""
        if self._gripper is None:
            self._connect()
        return self._gripper

    def close(self) -> None:
        """Let go of the robot; it holds its position."""
        self._robot = self._gripper = None

    def make_ready(self) -> None:
        """Before a motion: recover from what the last one ended in, if the robot can by now; one try.

        Raises the last one's `StuckError` while it cannot.
        """
        with self.speaking():
            if self._unrecovered and not self._is_ready(tries=1):
                raise self._held()
        self._unrecovered = ""

    @contextmanager
    def speaking(self) -> Iterator[None]:
        """Turn franky's exceptions into ours; a lost link is forgotten, so that the next use connects again."""
        try:
            yield
        except self._franky.ControlException as error:
            raise self._recover(str(error)) from None
        except (self._franky.CommandException, self._franky.GripperException) as error:
            raise self._refused(error) from None
        except (self._franky.NetworkException, RuntimeError) as error:
            if isinstance(error, RuntimeError) and "Net Exception" not in str(error):
                raise
            self.close()
            raise ArmError(
                f"the link to the robot at {self.host} was lost ({_line(error)}); the robot stops by itself when that "
                "happens. Check cable and power; the next motion connects again"
            ) from None

    def _refused(self, error: Exception) -> ArmError:
        """What a refusal means: nothing, perhaps, of a robot that is idle; of any other, that a person has it."""
        with self.speaking():
            idle = self._robot.state.robot_mode == self._franky.RobotMode.Idle
        return (ArmError if idle else StuckError)(
            f"the robot at {self.host} refused: {_line(error)}; look at its lights and at Desk: joints unlocked, "
            "FCI active, stop button released, nobody guiding it"
        )

    def _recover(self, message: str) -> BaggieError:
        """Get the robot going again after an error, and say what it was. Nothing moves."""
        with self.speaking():
            names = set(re.findall(r"\w+_\w+", f"{self._robot.state.last_motion_errors}"))
            what = ", ".join(sorted(names)) or _line(message)
            if not self._is_ready():
                self._unrecovered = what
                return self._held()
        text = f"the robot at {self.host} stopped on its way ({what}) and has recovered"
        if names & HICCUPS:
            return HiccupError(f"{text}; connect it directly and use a real-time kernel (docs/franka.md)")
        if names & COLLISIONS:
            return CollisionError(f"{text}; something is in its way, or it was pushed")
        return ReachError(f"{text}; choose another place or a lower speed")

    def _held(self) -> StuckError:
        return StuckError(
            f"the robot at {self.host} stopped ({self._unrecovered}) and does not recover by itself; look what holds "
            "it, release its stop button, move it free by hand in guiding mode; the next motion tries again"
        )

    def _is_ready(self, tries: int = RECOVERIES) -> bool:
        """Whether the robot is ready to move, after its automatic error recovery where it needs one."""
        for _ in range(tries):
            try:
                if self.robot.has_errors:
                    self.robot.recover_from_errors()  # what it returns may be late, as the mode is
                return self._is_idle()
            except self._franky.CommandException:  # "manual error recovery required", or not yet possible
                time.sleep(RETRY_PAUSE_S)
        return False

    def _is_idle(self) -> bool:
        """Whether the robot says that it is idle; just after it has recovered, it says so a little late."""
        deadline = time.monotonic() + IDLE_WITHIN_S
        while not (idle := bool(self.robot.state.robot_mode == self._franky.RobotMode.Idle)):
            if time.monotonic() > deadline:
                break
        return idle

    def _connect(self) -> None:
        franky = self._franky
        for attempt in range(CONNECT_TRIES):
            try:
                self._robot = _within(
                    CONNECT_TIMEOUT_S, lambda: franky.Robot(self.host, realtime_config=self._realtime)
                )
                self._gripper = _within(CONNECT_TIMEOUT_S, lambda: franky.Gripper(self.host))
                break
            except franky.IncompatibleVersionException as error:
                raise StuckError(_mismatch(self.host, str(error))) from None
            except franky.RealtimeException as error:
                raise StuckError(
                    f"no real-time priority here ({_line(error)}); install a real-time kernel (docs/franka.md), or "
                    "write `realtime: false` below `arm` in the workcell file to go without"
                ) from None
            except (franky.NetworkException, TimeoutError) as error:
                self.close()
                if isinstance(error, TimeoutError) or attempt == CONNECT_TRIES - 1:
                    raise ArmError(
                        f"no robot answers at {self.host} ({_line(error)}); check power, cable and address, and "
                        "activate FCI in Desk"
                    ) from None
                time.sleep(RETRY_PAUSE_S)
        try:
            self._prepare()
        except BaseException:
            self.close()
            raise

    def _prepare(self) -> None:
        """Bring a robot just connected into a state in which motions make sense."""
        with self.speaking():
            state = self._robot.state
            _check_tool(np.asarray(state.F_T_EE.matrix, float))
            if not self._is_ready():
                raise StuckError(
                    f"the robot at {self.host} is not ready to move (mode {state.robot_mode.name}, errors "
                    f"{state.current_errors}); release its stop button, unlock its joints and activate FCI in Desk"
                )
            self._robot.set_collision_behavior(REFLEX_TORQUES_NM, REFLEX_FORCE_N)
            if self._gripper.max_width < 0.01:  # never homed since it was switched on
                self._gripper.homing()


def _check_tool(T_flange_tool: FloatArray) -> None:
    """Raise `StuckError` unless the robot's own tool is the point between the fingertips of Franka's hand."""
    off_m, off_rad = difference(T_FLANGE_TOOL, T_flange_tool)
    if off_m > 0.001 or off_rad > 0.01:
        raise StuckError(
            f"expected Franka's hand as the end effector, {1000 * TOOL_OFFSET_M:.1f} mm from flange to fingertips; the "
            f"robot's is {1000 * off_m:.1f} mm and {np.rad2deg(off_rad):.1f} degrees away from that. Choose 'Franka "
            "Hand' as end effector in Desk"
        )


def _mismatch(host: str, message: str) -> str:
    found = re.search(r"server version: (\d+), library version: (\d+)", message)
    robot, library = found.groups() if found else ("VERSION", "another")
    wheel = ("--force-reinstall", "franky-control", "--extra-index-url", f"{WHEELS}/{robot}/")
    return (
        f"the robot at {host} speaks version {robot} of the control protocol, the franky-control installed here "
        f"version {library}: {pip_install(*wheel)}"
    )


def _within(seconds: float, call: Callable[[], Any]) -> Any:
    """What a call returns or raises, or `TimeoutError`; the call is left to itself then.

    In a thread of its own, which then ends, for another reason, too: libfranka raises whoever connects to the highest
    real-time priority it can get, whether or not that was asked for, and threads and processes begun later inherit it.
    """
    answer: list[Any] = []
    failure: list[BaseException] = []

    def work() -> None:
        try:
            answer.append(call())
        except BaseException as error:
            failure.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(seconds)
    if failure:
        raise failure[0]
    if not answer:
        raise TimeoutError(f"no answer within {seconds:.0f} s")
    return answer[0]


def _line(text: object) -> str:
    return " ".join(str(text).removeprefix("libfranka: ").split()).rstrip(".!")
