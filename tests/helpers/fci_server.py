"""franky-sim's own arm behind the lab's server, as a process of its own, with a box to touch and faults on demand.

`python fci_server.py ADDRESS...` listens at the first of these that is free, prints it, and obeys one command a line:

    reflex NAME   the motion under way ends with this error, and so does the next if there is none
    stuck, free   automatic error recovery fails from now on, or works again
    count         print how many motions were begun, and how many errors recovered from
"""

from __future__ import annotations

import sys
import threading
import xml.etree.ElementTree as ET

from franky_sim import simulation_server
from franky_sim.mujoco_simulator import MUJOCO_DEFAULT_KP, MujocoSimulator

from baggie.lab.fci import FciServer
from baggie.sim.arm_world import upward_touch

BOX = "0.49 0.0 0.05"
BOX_HALF = "0.04 0.04 0.05"
BOX_TOP_M = 0.10
FIRM = tuple(stiffness / 30 for stiffness in MUJOCO_DEFAULT_KP)
"""Damping with which the arm is 30 ms behind its commands; it is 100 ms with franky-sim's own."""
HOLD = [0.0, -0.5, 0.0, -2.2, 0.0, 1.7, 0.7853]


class FeelingServer(FciServer):
    """Knows how hard the hand presses on the box."""

    @property
    def robot_state(self):
        model, data = simulator.model, simulator.data
        push = 0.0 if model is None else -upward_touch(model, data, {model.body("box").id})
        return super().robot_state.replace(O_F_ext_hat_K=(0.0, 0.0, -push, 0.0, 0.0, 0.0))


def obey(lines, server):
    for line in lines:
        match line.split():
            case ["reflex", name]:
                server.abort(name)
            case ["stuck"]:
                server.get_stuck()
            case ["free"]:
                server.heal()
            case ["count"]:
                print(server.begun, server.recovered, flush=True)


if __name__ == "__main__":
    simulation_server.FrankaRobotServer = FeelingServer
    with MujocoSimulator() as simulator:
        robot = simulator.add_robot(initial_q=HOLD, kv=FIRM)
        body = ET.SubElement(simulator.worldbody, "body", name="box", pos=BOX)
        ET.SubElement(body, "geom", name="box", type="box", size=BOX_HALF)
        with simulation_server.SimulationServer(simulator, sys.argv[1:]) as server:
            print(robot.hostname, flush=True)
            threading.Thread(target=obey, args=(sys.stdin, server.robot_servers[0]), daemon=True).start()
            server.run_forever()
