"""franky-sim's FCI server as a process of its own, with a box to touch and with faults on demand.

`python fci_server.py ADDRESS...` listens at the first of these that is free, prints it, and obeys one command a line:

    reflex NAME   the motion under way ends with this error, and so does the next if there is none
    stuck, free   automatic error recovery fails from now on, or works again
    count         print how many motions were begun, and how many errors recovered from
"""

from __future__ import annotations

import sys
import threading
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
from franky_sim import simulation_server
from franky_sim.franka_robot_protocol import (
    AutomaticErrorRecoveryCommand,
    AutomaticErrorRecoveryStatus,
    BaseCommand,
    MoveStatus,
    RobotCommand,
    RobotMode,
)
from franky_sim.franka_robot_server import FrankaRobotServer
from franky_sim.mujoco_simulator import MUJOCO_DEFAULT_KP, MujocoSimulator

BOX = "0.49 0.0 0.05"
BOX_HALF = "0.04 0.04 0.05"
BOX_TOP_M = 0.10
FIRM = tuple(stiffness / 30 for stiffness in MUJOCO_DEFAULT_KP)
"""Damping with which the arm is 30 ms behind its commands; it is 100 ms with franky-sim's own."""
HOLD = [0.0, -0.5, 0.0, -2.2, 0.0, 1.7, 0.7853]
ERRORS = {"joint_reflex": 6, "cartesian_reflex": 7, "communication_constraints_violation": 25}
"""Positions in the protocol's list of errors (libfranka's `franka::Errors`)."""


class FaultyServer(FrankaRobotServer):
    """Knows what franky-sim leaves out: errors, reflexes, the force at the hand."""

    wanted: list[str] = []  # noqa: RUF012 -- there is one server
    stuck = False
    begun = recovered = 0
    error: str | None = None
    aborted = 0
    """The motion that has to be told so."""

    def start_motion(self, *args):
        if self.error is not None:
            raise RuntimeError("in an error")  # franky-sim answers that the motion is aborted
        type(self).begun += 1
        super().start_motion(*args)

    def _post_process_commands(self):
        if self.aborted:
            BaseCommand.send_response(
                self._tcp_socket, RobotCommand.kMove, self.aborted, MoveStatus.kReflexAborted
            )
            self.aborted = 0
        elif self.wanted and self.current_motion_id:
            self.error, self.aborted = self.wanted.pop(0), self.current_motion_id  # the state says so first
            self.stop_motion(send_preemption_signal=False)
            self.reset_current_motion_id()
        super()._post_process_commands()

    @property
    def robot_state(self):
        state = super().robot_state.replace(O_F_ext_hat_K=(0.0, 0.0, -force_on_box(), 0.0, 0.0, 0.0))
        if self.error is None:
            return state
        flags = tuple(index == ERRORS[self.error] for index in range(41))
        return state.replace(robot_mode=RobotMode.kReflex, errors=flags, reflex_reason=flags)


def recover(command, server):
    if server.stuck:
        command.reply(AutomaticErrorRecoveryStatus.kManualErrorRecoveryRequiredRejected)
        return
    server.error = None
    FaultyServer.recovered += 1
    command.reply(AutomaticErrorRecoveryStatus.kSuccess)


def force_on_box() -> float:
    """Newtons with which the hand presses on the box."""
    model, data = simulator.model, simulator.data
    if model is None:
        return 0.0
    box, wrench, total = model.geom("box").id, np.zeros(6), 0.0
    for number in range(data.ncon):
        if box in data.contact.geom[number] and 0 not in data.contact.geom[number]:
            mujoco.mj_contactForce(model, data, number, wrench)
            total += wrench[0]
    return total


def obey(lines):
    for line in lines:
        match line.split():
            case ["reflex", name]:
                FaultyServer.wanted.append(name)
            case ["stuck" | "free" as word]:
                FaultyServer.stuck = word == "stuck"
            case ["count"]:
                print(FaultyServer.begun, FaultyServer.recovered, flush=True)


if __name__ == "__main__":
    AutomaticErrorRecoveryCommand.handle = recover
    simulation_server.FrankaRobotServer = FaultyServer
    with MujocoSimulator() as simulator:
        robot = simulator.add_robot(initial_q=HOLD, kv=FIRM)
        body = ET.SubElement(simulator.worldbody, "body", name="box", pos=BOX)
        ET.SubElement(body, "geom", name="box", type="box", size=BOX_HALF)
        with simulation_server.SimulationServer(simulator, sys.argv[1:]) as server:
            print(robot.hostname, flush=True)
            threading.Thread(target=obey, args=(sys.stdin,), daemon=True).start()
            server.run_forever()
