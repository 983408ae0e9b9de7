"""Policies that `baggie export` wrote: they plan as they were trained to, and need onnxruntime in place of PyTorch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import DataError, install_extra
from baggie.policies import checkpoint
from baggie.policies.base import Policy
from baggie.policies.planning import (
    REGRESSION_SIDE,
    Float32,
    GoalInput,
    Reading,
    View,
    keypoint_plan,
    regression_goal_input,
    regression_plan,
)
from baggie.types import Goal, Observation, Plan, require_goal


class Graph:
    """A network as a file, run by onnxruntime on the CPU, with as many threads as OpenCV has when it is loaded.

    `cv2.setNumThreads` so decides for the whole of a decision.
    """

    def __init__(self, path: Path) -> None:
        """Load `path`. Raises `DataError` when it is damaged, or onnxruntime is not installed."""
        try:
            import onnxruntime  # noqa: PLC0415 -- an extra
        except ModuleNotFoundError:
            raise DataError(
                f"{path} needs onnxruntime, which is not installed here: {install_extra('deploy')}"
            ) from None
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = max(cv2.getNumThreads(), 1)
        options.log_severity_level = 3
        # Between decisions, which are rare, its threads would keep the cores busy with waiting.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        try:
            self._session = onnxruntime.InferenceSession(
                path.read_bytes(), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime has a class of its own for every way to be damaged
            raise DataError(
                f"{path} cannot be read ({type(error).__name__}): it is cut off or damaged; export the run again"
            ) from None
        self.inputs: Mapping[str, Sequence[int | str]] = {
            node.name: tuple(node.shape) for node in self._session.get_inputs()
        }
        """Their shapes by name; a side of any length has a name in place of its length."""

    def run(self, outputs: Sequence[str], inputs: Mapping[str, NDArray[Any]]) -> list[Float32]:
        """Run the network: these outputs, in this order."""
        given = {name: np.ascontiguousarray(array) for name, array in inputs.items()}
        return [np.asarray(part, np.float32) for part in self._session.run(list(outputs), given)]


class ExportedPolicy(Policy):
    """Base of exported policies: it belongs to one cell, and to pictures of one shape."""

    wants_goal = True

    def __init__(self, graph: Graph, config: Mapping[str, Any]) -> None:
        """`config`: the content of `config.yaml`. Raises `KeyError`, `TypeError`, `ValueError` for what is none."""
        self.graph = graph
        self.picture_size, self.camera_size = checkpoint.sizes(config)
        self.cell = int(config["cell"])
        self.name = str(config["policy"])


class ExportedKeypoint(ExportedPolicy):
    """An exported `keypoint` policy; see `keypoint_plan`."""

    def __init__(self, graph: Graph, config: Mapping[str, Any]) -> None:
        super().__init__(graph, config)
        self.view = View.of(config["model"]["view"], self.picture_size)
        self.goal_input = GoalInput.of(config["model"]["goal"])
        width, height = self.view.size
        _check(graph, (1, self.goal_input.channels, height, width))

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Where to pick and where to place; see `keypoint_plan`, whose errors it raises."""
        return keypoint_plan(
            self.read,
            self.view,
            self.goal_input,
            observation,
            require_goal(goal),
            camera_size=self.camera_size,
            knows_layers=self.knows_layers,
        )

    @property
    def knows_layers(self) -> bool:
        """Whether it learned from stacks; else its graph is not asked for layers."""
        return "layers" in self.graph.inputs

    def read(self, images: NDArray[np.uint8], near: Float32, corners: Float32, layers: Float32) -> Reading:
        """Run the network; see `KeypointRead`."""
        given: dict[str, NDArray[Any]] = {"images": images, "near": near, "corners": corners}
        if self.knows_layers:
            given["layers"] = layers
        return Reading(*self.graph.run(Reading._fields, given))


class ExportedRegression(ExportedPolicy):
    """An exported `regression` policy; see `regression_plan`."""

    def __init__(self, graph: Graph, config: Mapping[str, Any]) -> None:
        super().__init__(graph, config)
        self.goal_input = regression_goal_input(config["model"])
        _check(graph, (1, 3, REGRESSION_SIDE, REGRESSION_SIDE))

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Pick and place positions; see `regression_plan`, whose errors it raises."""
        return regression_plan(
            self.read,
            self.goal_input,
            self.picture_size,
            observation,
            require_goal(goal),
            camera_size=self.camera_size,
        )

    def read(self, images: NDArray[np.uint8]) -> Float32:
        """Run the network; see `RegressionRead`."""
        return self.graph.run(["xy"], {"images": images})[0]


EXPORTED: Mapping[str, type[ExportedPolicy]] = {
    "keypoint": ExportedKeypoint,
    "regression": ExportedRegression,
}
"""By the name in `config.yaml`."""


def load_exported(folder: Path, device: str = "cpu") -> ExportedPolicy:
    """The exported policy in a folder.

    Raises `DataError` when a file is missing, damaged, or of another policy, onnxruntime is not installed, or the
    device is not the CPU.
    """
    if device != "cpu":
        raise DataError(
            f"an exported policy runs on the CPU, but {device} was asked for: load the training run there"
        )
    config = checkpoint.read_config(folder)
    graph = Graph(folder / checkpoint.GRAPH)
    try:
        return EXPORTED[config["policy"]](graph, config)
    except (KeyError, TypeError, ValueError):
        raise DataError(
            f"{folder / checkpoint.CONFIG} and {checkpoint.GRAPH} do not belong together: take both from one export"
        ) from None


def _check(graph: Graph, shape: tuple[int, ...]) -> None:
    if graph.inputs.get("images") != shape:
        raise ValueError(f"expected images of {shape}, got inputs {graph.inputs}")
