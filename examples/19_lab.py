"""The virtual lab: a Franka that is not there, moved by the code that moves a real one.

Shows that nothing above a workcell knows whether it is real: the lab speaks the robot's own protocol and streams its
camera's pictures over the network, and a workcell file opens it as it opens a real cell. It can also do what a real one
does at the worst moment; here the arm is told that it has run into something. Needs
`pip install "franky-control>=2,<3"`.

Prints what came of two picks and places, the second with a fault in it:

    bag at (0.46, -0.04): success
    with a reflex on the way: the robot at 127.0.7.1 stopped on its way (cartesian_reflex) and has recovered; ...
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import baggie
from baggie.errors import BaggieError
from baggie.geometry import PlanarPose
from baggie.lab.web import LabControl
from baggie.types import PickPlace

GOAL, BACK = PlanarPose(0.50, 0.15), PlanarPose(0.50, -0.15)
HOST = "127.0.7.1"  # a second lab on this computer takes another address
LAB = ["lab", "--host", HOST, "--camera-port", "8090", "--pace", "0", "--size", "640x360", "--out"]


def main() -> None:
    """Start a lab, use it, end it."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "lab.yaml")
        command = [sys.executable, "-m", "baggie", *LAB, str(file)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as lab:
            assert lab.stdout is not None
            lab.stdout.readline()  # it prints the workcell file once it can be reached
            try:
                use(file)
            except BaggieError as error:
                sys.exit(f"error: {error}")
            finally:
                lab.terminate()


def use(file: Path) -> None:
    """Two picks and places by a workcell file."""
    control = LabControl(f"http://{HOST}:8090")  # knows the truth, and lets things go wrong
    cell = baggie.open_workcell(file)
    cell.look()
    bag = control.bag_pose()
    outcome = cell.execute(PickPlace(bag, GOAL))
    print(f"bag at ({bag.x:.2f}, {bag.y:.2f}): {outcome.failure or 'success'}")
    control.fault("reflex", after=1.0)  # of the lab's time
    try:
        outcome = cell.execute(PickPlace(control.bag_pose(), BACK))
        print(f"with a reflex on the way: {outcome.failure or 'success'}")
    except BaggieError as error:
        print(f"with a reflex on the way: {error}")
    cell.close()


if __name__ == "__main__":
    main()
