"""A trained policy as files that run without PyTorch: `policy.onnx` and `config.yaml`."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from baggie.errors import BaggieError, DataError, install_extra
from baggie.options.evaluating import ExportOptions
from baggie.policies import checkpoint, load_policy
from baggie.policies.exported import Graph
from baggie.policies.keypoint.policy import KeypointPolicy
from baggie.policies.learned import LearnedPolicy
from baggie.policies.planning import REGRESSION_SIDE, Reading
from baggie.policies.regression import RegressionPolicy

_OPSET = 17
"""onnxruntime knows it since 1.12."""
_TOLERANCE = 1e-4
"""Metres, radians, shares: what the exported network may be off from PyTorch's."""
_PICTURES = 5
"""On which both are compared before anything is written."""

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Exportable:
    """A network, and what its file says of it."""

    module: nn.Module
    inputs: Arrays
    """By name; examples whose shapes are those of the file, but for `lengths`."""
    outputs: Sequence[str]
    lengths: Mapping[str, str]
    """Inputs and outputs whose first side may be of any length, and what that is called."""

    @classmethod
    def of(cls, policy: LearnedPolicy) -> Exportable:
        """What a policy runs. Raises `BaggieError` for a kind that is not known here."""
        if isinstance(policy, KeypointPolicy):
            width, height = policy.view.size
            inputs: dict[str, NDArray[Any]] = {
                "images": np.zeros((1, policy.goal_input.channels, height, width), np.uint8),
                "near": np.zeros(3, np.float32),
                "corners": np.zeros((4, 2), np.float32),
            }
            if policy.knows_layers:
                inputs |= {"layers": np.zeros(2, np.float32)}
            lengths = {"corners": "corners", "goal_xy": "corners"}
            return cls(policy.reader(), inputs, Reading._fields, lengths)
        if isinstance(policy, RegressionPolicy):
            side = REGRESSION_SIDE
            return cls(policy.network.eval(), {"images": np.zeros((1, 3, side, side), np.uint8)}, ["xy"], {})
        raise BaggieError(
            f"expected a keypoint or regression policy to export, got {policy.name}; that one runs with PyTorch only: "
            "take its run's folder itself, wherever an exported one would do"
        )

    def run(self, inputs: Arrays) -> list[NDArray[np.float32]]:
        """What PyTorch says, in the order of `outputs`."""
        with torch.inference_mode():
            found = self.module(*(torch.from_numpy(array) for array in inputs.values()))
        return [part.numpy() for part in (found if isinstance(found, tuple) else (found,))]

    def onnx(self) -> bytes:
        """The content of `policy.onnx`."""
        written = io.BytesIO()
        arguments = tuple(torch.from_numpy(array) for array in self.inputs.values())
        with warnings.catch_warnings(), torch.no_grad():
            # The exporter that traces is the old one: a second instead of half a minute, half the file, and no
            # packages but onnx. What it warns of, numbers frozen that should not be, is what `differences` looks for.
            warnings.simplefilter("ignore")
            torch.onnx.export(
                self.module,
                arguments,
                written,  # type: ignore[arg-type]  # its stubs know only paths
                dynamo=False,
                opset_version=_OPSET,
                input_names=list(self.inputs),
                output_names=list(self.outputs),
                dynamic_axes={name: {0: length} for name, length in self.lengths.items()},
            )
        return written.getvalue()

    def differences(self, graph: Graph, seed: int = 0) -> dict[str, float]:
        """How far `graph` is off from PyTorch, at most, by output, on random pictures and goals."""
        worst = dict.fromkeys(self.outputs, 0.0)
        for inputs in self._random(np.random.default_rng(seed)):
            ours, theirs = self.run(inputs), graph.run(self.outputs, inputs)
            for name, a, b in zip(self.outputs, ours, theirs, strict=True):
                off = float(np.abs(a - b).max()) if a.shape == b.shape else float("inf")
                worst[name] = max(worst[name], off)
        return worst

    def _random(self, rng: np.random.Generator) -> Iterator[Arrays]:
        """Pictures, goals of three corners and more, in any layer it knows; on the last, what is pointed at."""
        for number in range(_PICTURES):
            images = self.inputs["images"]
            inputs: dict[str, NDArray[Any]] = {"images": rng.integers(0, 256, images.shape, np.uint8)}
            if "near" in self.inputs:
                middle = np.array(images.shape[:1:-1]) / 4  # of the heat maps, in cells
                radius = 16.0 if number == _PICTURES - 1 else 1e4
                inputs["near"] = np.array([*middle, radius], np.float32)
                inputs["corners"] = rng.uniform(-0.5, 0.5, (3 + number, 2)).astype(np.float32)
            if "layers" in self.inputs:
                inputs["layers"] = rng.integers(0, 4, 2).astype(np.float32)
            yield inputs


def export_policy(policy: LearnedPolicy, folder: Path) -> dict[str, float]:
    """Write `policy.onnx` and `config.yaml`, complete or not at all; how far off from PyTorch it is, by output.

    Raises `BaggieError` when onnx or onnxruntime is not installed, the result is further off than 1e-4, or the folder
    cannot be written.
    """
    exportable = Exportable.of(policy)
    missing = [name for name in ("onnx", "onnxruntime") if find_spec(name) is None]
    if missing:
        raise BaggieError(f"exporting needs {' and '.join(missing)}: {install_extra('export')}")
    if (folder / checkpoint.WEIGHTS).exists():
        raise DataError(f"{folder} holds a training run: give --out another folder")
    content = exportable.onnx()
    with TemporaryDirectory() as scratch:
        path = Path(scratch, checkpoint.GRAPH)
        path.write_bytes(content)
        off = exportable.differences(Graph(path))
    if max(off.values()) > _TOLERANCE:
        raise BaggieError(
            f"the exported network is off from PyTorch's by {off}, more than {_TOLERANCE}: nothing was written; try "
            "the versions of torch, onnx and onnxruntime in constraints.txt"
        )
    config = checkpoint.config_bytes(policy.config())
    checkpoint.write_files(folder, {checkpoint.GRAPH: content, checkpoint.CONFIG: config})
    return off


def export(options: ExportOptions) -> dict[str, Any]:
    """Do what `baggie export` is asked for: where it is, its size, how far off from PyTorch. Raises `BaggieError`."""
    policy = load_policy(options.policy)
    if not isinstance(policy, LearnedPolicy):
        raise BaggieError(
            f"{options.policy} holds a {policy.name} policy that runs without PyTorch already: "
            "give the folder of a training run"
        )
    off = export_policy(policy, options.out)
    path = options.out / checkpoint.GRAPH
    return {
        "policy": policy.name,
        "exported": str(path),
        "size_mb": path.stat().st_size / 1e6,
        "largest_difference": off,
    }
