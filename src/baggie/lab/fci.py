"""Franka's control protocol before a simulated robot: franky-sim's server, and what it leaves out, errors."""

from __future__ import annotations

import select
import time
from typing import Any

from franky_sim.franka_robot_protocol import (
    AutomaticErrorRecoveryCommand,
    AutomaticErrorRecoveryStatus,
    BaseCommand,
    MoveStatus,
    RobotCommand,
    RobotMode,
)
from franky_sim.franka_robot_server import FrankaRobotServer
from franky_sim.franka_robot_state import FrankaRobotState

ERRORS = {"joint_reflex": 6, "cartesian_reflex": 7, "communication_constraints_violation": 25}
"""Positions in the protocol's list of errors (libfranka's `franka::Errors`)."""
LATE = "communication_constraints_violation"
LOST_AT_MOST = 20
"""Packets in a row; a Franka robot stops when it has missed so many."""
ANSWER_S = 0.03
"""So long a client may take to answer while it moves the arm, before time goes on without it."""


class FciServer(FrankaRobotServer):  # type: ignore[misc]  # franky-sim has no types
    """A robot that can have errors, refuse, lose packets and be cut off; one client at a time.

    While a motion is under way it waits for the client's answer to every state, so that a busy computer makes it slow
    and nothing worse. Everything here is called from one thread.
    """

    def __init__(self, robot: Any, hostname_candidates: Any) -> None:
        super().__init__(robot, hostname_candidates)
        self.begun = self.recovered = 0
        """Motions, and errors."""
        self._error: str | None = None
        self.heal()

    def heal(self) -> None:
        """Let nothing go wrong any more; an error that there is already has to be recovered from."""
        self._wanted: list[str] = []
        self._refusals = 0
        self._deaf_ticks = self._lost = 0
        self._deaf = False
        self._back_at = 0.0
        self._stuck = False
        self._aborted = 0

    # -- what can go wrong --------------------------------------------------------------------------------------

    def abort(self, error: str) -> None:
        """End the motion under way with one of `ERRORS`; or the next, where there is none."""
        self._wanted.append(error)

    def refuse(self) -> None:
        """Refuse the next motion."""
        self._refusals += 1

    def get_stuck(self) -> None:
        """Recover from no error any more."""
        self._stuck = True

    def lose_packets(self, ticks: int) -> None:
        """Hear nothing from the client for so many milliseconds of the robot's time, from when it moves."""
        self._deaf_ticks, self._deaf = ticks, False

    def cut(self, seconds: float) -> None:
        """Cut the connection, as if somebody pulled the cable, and put it back after `seconds` of the wall clock."""
        self.reset_state()
        self.gripper_server.reset_state()
        self._back_at = time.monotonic() + seconds

    def hold(self) -> None:
        """Take note that the robot is somewhere else now, and hold it there."""
        self.stop_motion(send_preemption_signal=False)

    # -- franky-sim's server, with that in it -------------------------------------------------------------------

    @property
    def moving(self) -> bool:
        """Whether somebody moves the arm."""
        return bool(self.current_motion_id)

    def process_commands(self) -> None:
        """Do what came from the client since the last tick."""
        if time.monotonic() >= self._back_at:
            super().process_commands()
        else:
            self._post_process_commands()

    def start_motion(self, *arguments: Any) -> None:
        """Begin a motion. Raises `RuntimeError` when it is refused; the client is told then that it is aborted."""
        if self._error is not None or self._refusals:
            self._refusals = max(self._refusals - 1, 0)
            raise RuntimeError("refused")
        self.begun += 1
        self._lost = 0
        super().start_motion(*arguments)

    def _process_udp_commands(self) -> None:
        if self.moving and self.udp_connected and not self._deaf:
            select.select([self._FrankaServer__udp_socket], [], [], ANSWER_S)
        super()._process_udp_commands()

    def _handle_udp_command(self, command_data: bytes) -> None:
        if not self._deaf:
            super()._handle_udp_command(command_data)

    def _post_process_commands(self) -> None:
        self._lose()
        if self._aborted:
            BaseCommand.send_response(
                self._tcp_socket, RobotCommand.kMove, self._aborted, MoveStatus.kReflexAborted
            )
            self._aborted = 0
        elif self._wanted and self.moving:
            self._error, self._aborted = (
                self._wanted.pop(0),
                self.current_motion_id,
            )  # the state says so first
            self.stop_motion(send_preemption_signal=False)
            self.reset_current_motion_id()
        super()._post_process_commands()

    def _lose(self) -> None:
        self._deaf = self._deaf_ticks > 0 and (self._deaf or self.moving)
        self._lost = self._lost + 1 if self._deaf and self.moving else 0
        self._deaf_ticks -= self._deaf
        if self._lost == LOST_AT_MOST:
            self.abort(LATE)

    def recover(self) -> AutomaticErrorRecoveryStatus:
        """What automatic error recovery comes to."""
        if self._stuck:
            return AutomaticErrorRecoveryStatus.kManualErrorRecoveryRequiredRejected
        self._error = None
        self.recovered += 1
        return AutomaticErrorRecoveryStatus.kSuccess

    @property
    def robot_state(self) -> FrankaRobotState:
        """What the client is told."""
        state = super().robot_state
        if self._error is None:
            return state
        flags = tuple(index == ERRORS[self._error] for index in range(41))
        return state.replace(robot_mode=RobotMode.kReflex, errors=flags, reflex_reason=flags)


def _recover(command: AutomaticErrorRecoveryCommand, server: FciServer) -> None:
    command.reply(server.recover())


AutomaticErrorRecoveryCommand.handle = _recover  # franky-sim's own always succeeds
