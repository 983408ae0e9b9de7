"""A Panda, a slanted camera and a hard red cube in PyBullet, spoken to over a local socket. It knows nothing of Baggie.

    python -m venv .venv-pybullet && .venv-pybullet/bin/pip install -r examples/pybullet_cell/requirements.txt
    .venv-pybullet/bin/python examples/pybullet_cell/simulator.py --port 8765

A request is a line of JSON, `{"do": "move_to", "x": 0.5, ...}`; so is its answer; where it cannot be done, one
with `"error"` and its `"kind"`, `"reach"` or `"stopped"`. Metres, radians, newtons, in the robot's base frame; z = 0
is at the table top; at yaw 0 the fingers open along y.
"""

from __future__ import annotations

import argparse
import base64
import json
import math
import socketserver
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
import pybullet_data
from numpy.typing import NDArray
from pybullet_utils.bullet_client import BulletClient

Floats = NDArray[np.float64]

STEP_S = 0.001
ARM_JOINTS, FINGER_JOINTS, WRIST_JOINT, TOOL_LINK = tuple(range(7)), (9, 10), 8, 11
HOME = (0.0, -0.5, 0.0, -2.2, 0.0, 1.8, 0.785)
JOINTS_FROM = np.array([-2.85, -1.7, -2.85, -3.0, -2.85, 0.0, -2.85])
JOINTS_TO = np.array([2.85, 1.7, 2.85, -0.1, 2.85, 3.7, 2.85])
TORQUES = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
PARK = (0.30, -0.45, 0.40, 0.0)
TURN_RAD_S, FINGERS_M_S, FINGERS_N = 1.5, 0.1, 20.0
QUINTIC_PEAK = 1.875
"""How much faster than on average a motion is at its fastest."""
LINE_STEP_M, LINE_STEP_RAD = 0.005, 0.02

CUBE_M, CUBE_KG = 0.065, 0.15
CUBE_COLOR = (0.75, 0.08, 0.08, 1.0)
STIFFNESS_N_M, DAMPING_N_S_M = 2e4, 150.0
"""Of what touches: a block of wood and rubber pads."""
SMOOTHED_S = 0.02
"""Over so long the wrist's force is averaged."""
SIZE, NOISE = (640, 480), 2.0
CAMERA_AT, CAMERA_TO, CAMERA_DEG = (1.20, 0.30, 0.85), (0.48, 0.0, 0.0), 42.0


class ReachError(Exception):
    """The arm does not get there; nothing has moved."""


class StoppedError(Exception):
    """The arm was stopped."""


class Cell:
    """The running simulation. Only `stop` may be called while something else is under way."""

    def __init__(self, seed: int) -> None:
        self._stopped = threading.Event()
        self._noise = np.random.default_rng(seed)
        self._bullet, self._plans = (BulletClient(pybullet.DIRECT) for _ in range(2))
        self._plan_arm = _load(self._plans, "franka_panda/panda.urdf", useFixedBase=True)
        bullet = self._bullet
        bullet.setTimeStep(STEP_S)
        bullet.setGravity(0, 0, -9.81)
        _load(bullet, "plane.urdf", (0, 0, -0.6))
        self._table = _box(bullet, (0.40, 0.60, 0.02), (0.65, 0, -0.02), (0.82, 0.72, 0.58, 1), 0.0)
        # What lies about, as on every table: a camera that was bumped sees it elsewhere.
        _box(bullet, (0.04, 0.03, 0.03), (0.30, -0.52, 0.03), (0.2, 0.5, 0.3, 1), 0.0)
        _box(bullet, (0.04, 0.03, 0.02), (0.95, 0.50, 0.02), (0.3, 0.3, 0.4, 1), 0.0)
        self._cube = _box(bullet, (CUBE_M / 2,) * 3, (0.5, 0, CUBE_M / 2), CUBE_COLOR, CUBE_KG)
        self._arm = _load(bullet, "franka_panda/panda.urdf", useFixedBase=True)
        touching = [(self._table, -1), (self._cube, -1), *((self._arm, link) for link in FINGER_JOINTS)]
        for body, link in touching:
            bullet.changeDynamics(
                body,
                link,
                lateralFriction=1.0,
                spinningFriction=0.002,
                contactStiffness=STIFFNESS_N_M,
                contactDamping=DAMPING_N_S_M,
            )
        bullet.enableJointForceTorqueSensor(self._arm, WRIST_JOINT)
        together = bullet.createConstraint(
            self._arm, 9, self._arm, 10, bullet.JOINT_GEAR, (1, 0, 0), (0, 0, 0), (0, 0, 0)
        )
        bullet.changeConstraint(together, gearRatio=-1, erp=0.1, maxForce=50)
        self._felt: deque[float] = deque(maxlen=round(SMOOTHED_S / STEP_S))
        self._pressed_n = 0.0
        self._plate: tuple[int, float] | None = None
        self._pictures: list[dict[str, float]] = []
        self._hold(np.array(HOME), reset=True)
        self._fingers(0.08, FINGERS_N)
        self._run(0.3)
        self.park()

    # ---- what a robot does

    def pose(self) -> dict[str, float]:
        """Where the tool is, by the joints."""
        state = self._bullet.getLinkState(self._arm, TOOL_LINK, computeForwardKinematics=True)
        turned = self._bullet.getMatrixFromQuaternion(state[5])
        x, y, z = state[4]
        return {"x": x, "y": y, "z": z, "yaw": math.atan2(turned[3], turned[0])}

    def move_to(self, x: float, y: float, z: float, yaw: float, speed: float) -> dict[str, float]:
        """Straight there."""
        self._follow(*self._line((x, y, z, yaw), speed))
        return self.pose()

    def lower_until_contact(self, z_min: float, speed: float, force: float) -> dict[str, float]:
        """Straight down until the wrist feels more than it did at the start."""
        here = self.pose()
        if here["z"] > z_min:
            self._run(0.1)
            weight = self._upward_n()
            line = self._line((here["x"], here["y"], z_min, here["yaw"]), speed)
            self._follow(*line, until=lambda: self._upward_n() - weight > force)
        return self.pose()

    def move_gripper(self, width: float) -> float:
        """Open or close, and wait."""
        self._fingers(width, FINGERS_N)
        self._run(abs(width - self.gripper_width()) / FINGERS_M_S + 0.2)
        return self.gripper_width()

    def grasp(self, force: float) -> float:
        """Close until the fingers stand, and go on squeezing."""
        self._bullet.setJointMotorControlArray(
            self._arm,
            FINGER_JOINTS,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=(-0.04, -0.04),
            forces=(force, force),
        )
        before = math.inf
        while before - self.gripper_width() > 1e-4:
            before = self.gripper_width()
            self._run(0.1)
        self._run(0.1)
        return self.gripper_width()

    def gripper_width(self) -> float:
        """Between the fingers."""
        return float(sum(state[0] for state in self._bullet.getJointStates(self._arm, FINGER_JOINTS)))

    def park(self) -> dict[str, float]:
        """Up, and aside."""
        here = self.pose()
        if here["z"] < PARK[2]:
            self.move_to(here["x"], here["y"], PARK[2], here["yaw"], 0.5)
        return self.move_to(*PARK, 0.5)

    def stop(self) -> None:
        """Whatever moves ends."""
        self._stopped.set()

    # ---- what a camera does

    def picture(self) -> dict[str, Any]:
        """What the camera sees now: RGB, base64."""
        bullet, (width, height) = self._bullet, SIZE
        self._carry_plate()
        view = bullet.computeViewMatrix(CAMERA_AT, CAMERA_TO, (0, 0, 1))
        lens = bullet.computeProjectionMatrixFOV(CAMERA_DEG, width / height, 0.1, 5.0)
        seen = bullet.getCameraImage(
            width,
            height,
            view,
            lens,
            lightDirection=(0.6, -0.5, 2.0),
            shadow=0,
            renderer=bullet.ER_TINY_RENDERER,
        )
        color = np.asarray(seen[2], float).reshape(height, width, -1)[..., :3]
        self._pictures.append({"time": time.time(), **self._cube_pose()})
        noisy = np.clip(np.rint(color + self._noise.normal(0, NOISE, color.shape)), 0, 255).astype(np.uint8)
        return {"size": SIZE, "rgb": base64.b64encode(noisy.tobytes()).decode()}

    # ---- what a person does, and what only a simulator knows

    def hold_plate(self, picture: str, side: float, ahead: float) -> None:
        """Fix a square plate with a picture on its upper face into the hand, its middle `ahead` of the fingertips."""
        with tempfile.TemporaryDirectory() as folder:
            square = Path(folder) / "plate.obj"
            half = side / 2
            corners = ((half, half, "0 1"), (half, -half, "1 1"), (-half, -half, "1 0"), (-half, half, "0 0"))
            square.write_text(
                "".join(f"v {x} {y} 0\n" for x, y, _ in corners)
                + "".join(f"vt {uv}\n" for _, _, uv in corners)
                + "vn 0 0 1\nf 1/1/1 4/4/1 3/3/1\nf 1/1/1 3/3/1 2/2/1\n"
            )
            shape = self._bullet.createVisualShape(
                pybullet.GEOM_MESH, fileName=str(square), rgbaColor=(1, 1, 1, 1)
            )
        plate = self._bullet.createMultiBody(0, -1, shape)
        self._bullet.changeVisualShape(plate, -1, textureUniqueId=self._bullet.loadTexture(picture))
        self._plate = plate, ahead

    def take_plate(self) -> None:
        """Out of the hand again."""
        if self._plate is not None:
            self._bullet.removeBody(self._plate[0])
            self._plate = None

    def lay_cube(self, x: float, y: float, yaw: float) -> None:
        """The cube there, standing; beside the table it is on the floor."""
        turn = self._bullet.getQuaternionFromEuler((0, 0, yaw))
        self._bullet.resetBasePositionAndOrientation(self._cube, (x, y, CUBE_M / 2), turn)
        self._run(0.5)

    def truth(self) -> dict[str, Any]:
        """Where the cube is and was in every picture, and how hard the table was pressed, since this was asked."""
        told = {**self._cube_pose(), "pictures": self._pictures, "pressed_n": self._pressed_n}
        self._pictures, self._pressed_n = [], 0.0
        return told

    # ---- below

    def _line(self, target: tuple[float, float, float, float], speed: float) -> tuple[list[Floats], float]:
        """Joint positions along the straight line, and how long it takes; the shorter turn, or where the wrist ends the
        longer. Raises `ReachError`.
        """
        here = self.pose()
        way = np.array(target[:3]) - (here["x"], here["y"], here["z"])
        turn = math.remainder(target[3] - here["yaw"], 2 * math.pi)
        try:
            joints = list(self._along(here, way, turn))
        except ReachError:
            turn -= math.copysign(2 * math.pi, turn)
            joints = list(self._along(here, way, turn))
        seconds = QUINTIC_PEAK * max(float(np.linalg.norm(way)) / speed, abs(turn) / TURN_RAD_S)
        return joints, max(seconds, 0.1)

    def _along(self, here: dict[str, float], way: Floats, turn: float) -> Iterator[Floats]:
        start = np.array([here["x"], here["y"], here["z"], here["yaw"]])
        joints = self._joints()
        yield joints
        count = math.ceil(max(float(np.linalg.norm(way)) / LINE_STEP_M, abs(turn) / LINE_STEP_RAD, 1))
        for share in np.linspace(0, 1, count + 1)[1:]:
            joints = self._solve(start + share * np.append(way, turn), joints)
            yield joints

    def _solve(self, pose: Floats, joints: Floats) -> Floats:
        """Joint positions near `joints` that take the tool, pointing down, to a pose; by Newton's method."""
        plans, arm = self._plans, self._plan_arm
        want = np.array(plans.getQuaternionFromEuler((math.pi, 0, float(pose[3]))))
        for _ in range(20):
            for joint, position in enumerate(joints):
                plans.resetJointState(arm, joint, position)
            state = plans.getLinkState(arm, TOOL_LINK, computeForwardKinematics=True)
            _, back = plans.invertTransform((0, 0, 0), state[5])
            _, off = plans.multiplyTransforms((0, 0, 0), want, (0, 0, 0), back)
            axis = 2 * math.copysign(1.0, off[3]) * np.array(off[:3])
            error = np.append(pose[:3] - np.array(state[4]), axis)
            if np.abs(error).max() < 1e-5:
                if (joints < JOINTS_FROM).any() or (joints > JOINTS_TO).any():
                    break
                return joints
            zeros = [0.0] * 9
            moves = plans.calculateJacobian(arm, TOOL_LINK, (0, 0, 0), [*joints, 0.04, 0.04], zeros, zeros)
            jacobian = np.vstack(moves)[:, :7]
            inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + 1e-6 * np.eye(6))
            elbow = 0.1 * (np.array(HOME) - joints)  # one joint more than a pose needs: they stay near home
            joints = joints + inverse @ error + elbow - inverse @ (jacobian @ elbow)
        x, y, z, yaw = pose
        raise ReachError(f"the arm does not reach x {x:.3f}, y {y:.3f}, z {z:.3f} m, yaw {yaw:.2f}")

    def _follow(
        self, joints: list[Floats], seconds: float, until: Callable[[], bool] = lambda: False
    ) -> None:
        """Along these joint positions, from rest to rest."""
        self._stopped.clear()
        way, marks = np.array(joints), np.linspace(0, 1, len(joints))
        for number in range(round(seconds / STEP_S)):
            share = (number + 1) * STEP_S / seconds
            along = share**3 * (10 - 15 * share + 6 * share**2)
            self._hold(np.array([np.interp(along, marks, way[:, joint]) for joint in ARM_JOINTS]))
            self._run(STEP_S)
            if self._stopped.is_set():
                self._hold(self._joints())
                raise StoppedError("the arm was stopped")
            if until():
                self._hold(self._joints())
                break
        self._run(0.15)

    def _hold(self, joints: Floats, reset: bool = False) -> None:
        if reset:
            for joint, position in enumerate(joints):
                self._bullet.resetJointState(self._arm, joint, position)
        self._bullet.setJointMotorControlArray(
            self._arm,
            ARM_JOINTS,
            pybullet.POSITION_CONTROL,
            targetPositions=joints.tolist(),
            forces=TORQUES,
            positionGains=(0.2,) * 7,
        )

    def _joints(self) -> Floats:
        return np.array([state[0] for state in self._bullet.getJointStates(self._arm, ARM_JOINTS)])

    def _fingers(self, width: float, force: float) -> None:
        for joint in FINGER_JOINTS:
            self._bullet.setJointMotorControl2(
                self._arm,
                joint,
                pybullet.POSITION_CONTROL,
                width / 2,
                force=force,
                maxVelocity=FINGERS_M_S / 2,
            )

    def _run(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(max(1, round(seconds / STEP_S))):
            self._bullet.stepSimulation()
            self._felt.append(self._bullet.getJointState(self._arm, WRIST_JOINT)[2][2])
            self._pressed_n = max(self._pressed_n, self._pressing_n())

    def _upward_n(self) -> float:
        """What pushes the hand up, less its weight. The sensor says what holds it, z down the hand."""
        return float(np.mean(self._felt))

    def _cube_pose(self) -> dict[str, float]:
        (x, y, z), turned = self._bullet.getBasePositionAndOrientation(self._cube)
        matrix = self._bullet.getMatrixFromQuaternion(turned)
        return {"x": x, "y": y, "z": z, "yaw": math.atan2(matrix[3], matrix[0])}

    def _pressing_n(self) -> float:
        """What the arm, and the cube while it is between the fingers, press on the table with."""
        touching = self._bullet.getContactPoints
        pressing = list(touching(self._arm, self._table))
        if all(touching(self._arm, self._cube, finger) for finger in FINGER_JOINTS):
            pressing += touching(self._cube, self._table)
        return float(sum(contact[9] for contact in pressing))

    def _carry_plate(self) -> None:
        if self._plate is not None:
            plate, ahead = self._plate
            here = self.pose()
            yaw = here["yaw"]
            at = (here["x"] + ahead * math.cos(yaw), here["y"] + ahead * math.sin(yaw), here["z"])
            turn = self._bullet.getQuaternionFromEuler((0, 0, yaw))
            self._bullet.resetBasePositionAndOrientation(plate, at, turn)


def _load(bullet: BulletClient, name: str, at: tuple[float, float, float] = (0, 0, 0), **options: Any) -> int:
    bullet.setAdditionalSearchPath(pybullet_data.getDataPath())
    return int(bullet.loadURDF(name, at, **options))


def _box(
    bullet: BulletClient,
    half: tuple[float, ...],
    at: tuple[float, float, float],
    color: tuple[float, ...],
    mass: float,
) -> int:
    shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half)
    looks = bullet.createVisualShape(bullet.GEOM_BOX, halfExtents=half, rgbaColor=color)
    return int(bullet.createMultiBody(mass, shape, looks, at))


class Server(socketserver.ThreadingTCPServer):
    """One request at a time, but `stop`, which comes through at once."""

    allow_reuse_address = daemon_threads = True

    def __init__(self, port: int, cell: Cell) -> None:
        super().__init__(("127.0.0.1", port), Requests)
        self.cell, self.busy = cell, threading.Lock()


class Requests(socketserver.StreamRequestHandler):
    """Line by line."""

    server: Server

    def handle(self) -> None:
        """Until the other side hangs up."""
        for line in self.rfile:
            self.wfile.write(json.dumps(self._answer(json.loads(line))).encode() + b"\n")

    def _answer(self, request: dict[str, Any]) -> Any:
        do = request.pop("do")
        if do == "stop":
            return self.server.cell.stop()
        with self.server.busy:
            try:
                return getattr(self.server.cell, do)(**request)
            except ReachError as error:
                return {"error": str(error), "kind": "reach"}
            except StoppedError as error:
                return {"error": str(error), "kind": "stopped"}


def main() -> None:
    """Serve until stopped."""
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--port", type=int, default=8765, help="0: any that is free; it is printed")
    words.add_argument("--seed", type=int, default=0, help="of the camera's noise")
    asked = words.parse_args()
    with Server(asked.port, Cell(asked.seed)) as server:
        print(f"ready at port {server.server_address[1]}", flush=True)
        server.serve_forever()


if __name__ == "__main__":
    main()
