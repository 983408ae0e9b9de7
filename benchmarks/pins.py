"""Whether this commit does what an earlier one does: equal scenes, recordings, trainings, evaluations, to the bit.

    python benchmarks/pins.py 627e01d

Both run the same commands, and every array that they leave is hashed: pictures as decoded, columns of tables, weights,
numbers of JSON and YAML. Times and the depth of bag pictures are left out. Prints what differs or is there on one side
alone; exit status 1 where something does. What the earlier commit left is kept in --out and not made again.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import tyro
import yaml
from safetensors.numpy import load_file

from baggie.evaluation.log import Episode

HERE = Path(__file__).resolve().parents[1]
SCENES = """
import sys, warnings
import baggie, gymnasium, numpy
warnings.simplefilter("ignore")
def arrays(name, value):
    if isinstance(value, dict):
        return {k: v for key in value for k, v in arrays(f"{name}-{key}", value[key]).items()}
    return {name: numpy.asarray(value)}
found = {}
for id in ("BagPlace", "BlockPyramid", "PlaceRedInGreen", "AlignBoxCorner", "BlockInsertion"):
    env = gymnasium.make(f"baggie/{id}-v0")
    for seed in range(10):
        observation, info = env.reset(seed=seed)
        if id == "BagPlace" and isinstance(observation, dict):
            observation.pop("depth", None)
        found |= arrays(f"{id}-{seed}-observation", observation) | arrays(f"{id}-{seed}-info", info)
    env.close()
numpy.savez(sys.argv[1], **{name: a for name, a in found.items() if a.dtype != object})
"""
COMMANDS = {
    "bags": "collect --task bag-place --attempts 10 --seed 1 --cell 3 --workers 1",
    "varied": "collect --task bag-place --attempts 4 --seed 2 --cell 4 --scenery varied --workers 1",
    "pyramid": "collect --task block-pyramid --attempts 2 --seed 1 --workers 1",
    "insertion": "collect --task block-insertion --style varied --attempts 3 --seed 2 --workers 1",
    "keypoint": "train --policy keypoint --data bags --train 6 --val 2 --steps 100 --device cpu",
    "regression": "train --policy regression --data bags --train 6 --val 2 --steps 4 --device cpu",
    "transporter": "train --policy transporter --data pyramid --train 1 --val 1 --steps 4 --device cpu",
    "inserter": "train --policy transporter --data insertion --train 2 --val 1 --steps 4 --device cpu",
    "keypoint-validated": "validate --policy keypoint --data bags",
    "transporter-validated": "validate --policy transporter --data pyramid",
    "keypoint-evaluated": "evaluate --policy keypoint --episodes 2 --seed 1 --cell 3 --workers 1",
    "mask-evaluated": "evaluate --policy color-mask --episodes 3 --seed 2 --cell 4 --workers 1",
    "oracle-evaluated": "evaluate --policy oracle --scenery varied --episodes 2 --seed 3 --cell 4 --workers 1",
    "transporter-evaluated": "evaluate --policy transporter --task block-pyramid --episodes 1 --seed 1 --workers 1",
    "demonstrator-evaluated": "evaluate --policy oracle --task align-box-corner --episodes 2 --seed 1 --workers 1",
}
VARIES = re.compile(r"(_s|_ms|_at|time|date|stamp|machine|commit|version|command|megabytes)$")


@dataclass(frozen=True)
class Options:
    """Compare this commit with an earlier one."""

    commit: tyro.conf.Positional[str]
    """The earlier one."""
    out: Path = Path("runs/pins")


def main(options: Options) -> int:
    """Run both, print what differs; the exit status."""
    folders = {name: options.out.resolve() / name for name in (options.commit, "this")}
    source = folders[options.commit] / "source"
    if not source.is_dir():
        subprocess.run(["git", "worktree", "add", "--detach", source, options.commit], cwd=HERE, check=True)
    shutil.rmtree(folders["this"], ignore_errors=True)
    digests = [
        of_all_commands(code, folder / "made")
        for folder, code in zip(folders.values(), (source, HERE), strict=True)
    ]
    before, after = digests
    for name in sorted(before | after):
        if before.get(name) != after.get(name):
            says = (
                "differs"
                if name in before and name in after
                else "only before"
                if name in before
                else "only now"
            )
            print(f"{says}: {name}")
    same = sum(before.get(name) == digest for name, digest in after.items())
    print(f"{same} of {len(before | after)} arrays are the same")
    return int(before != after)


def of_all_commands(code: Path, made: Path) -> dict[str, str]:
    """Run every command with some code into a folder, where it has not been; the digests of all arrays there."""
    made.mkdir(parents=True, exist_ok=True)
    environment = os.environ | {"PYTHONPATH": str(code / "src"), "OMP_NUM_THREADS": "1"}
    calls = {"scenes.npz": ["-c", SCENES, "scenes.npz"]}
    calls |= {name: ["-m", "baggie", *words.split(), "--out", name] for name, words in COMMANDS.items()}
    found: dict[str, str] = {}
    for name, call in calls.items():
        if not (done := made / f"{name}.done").exists():
            print(f"{code.name}: {name}", file=sys.stderr, flush=True)
            with (made / f"{name}.log").open("w") as log:
                subprocess.run(
                    [sys.executable, *call], cwd=made, env=environment, check=True, stderr=log, stdout=log
                )
            done.touch()
        paths = sorted((made / name).rglob("*")) if (made / name).is_dir() else [made / name]
        for path in paths:
            shown = str(path.relative_to(made)).replace("block-episodes", "episodes")  # an earlier name
            found |= {f"{shown}: {key}": digest(value) for key, value in arrays_in(path)}
    return found


def arrays_in(path: Path) -> Iterator[tuple[str, Any]]:
    """What a file holds, by name; nothing of files of a kind that is not compared."""
    match path.suffix:
        case ".npz":
            yield from np.load(path).items()
        case ".safetensors":
            yield from load_file(path).items()
        case ".png" | ".jpg":
            yield "pixels", cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        case ".json":
            yield from flat("", json.loads(path.read_text()))
        case ".jsonl":
            lines = [json.loads(line) for line in path.read_text().splitlines()]
            read = [Episode.from_json(line).to_json() for line in lines]  # whatever version logged them
            yield from flat("", json.loads(json.dumps(read)))
        case ".yaml":
            yield from flat("", yaml.safe_load(path.read_text()))
        case ".parquet":
            for column, values in pq.read_table(path).to_pydict().items():
                if "depth" not in column:
                    yield from flat(column, values)


def flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Numbers, words and pictures inside a nested value, by dotted name, without times."""
    if isinstance(value, Mapping):
        for key, part in value.items():
            if not VARIES.search(str(key)) and "depth" not in str(key):
                yield from flat(f"{name}.{key}", part)
    elif isinstance(value, list) and any(isinstance(part, Mapping | list | bytes) for part in value):
        for number, part in enumerate(value):
            yield from flat(f"{name}.{number}", part)
    elif not VARIES.search(name):
        yield name, value


def digest(value: Any) -> str:
    """A hash of an array, a picture's pixels, or a plain value."""
    if isinstance(value, bytes):
        pixels = cv2.imdecode(np.frombuffer(value, np.uint8), cv2.IMREAD_UNCHANGED)
        value = value if pixels is None else pixels
    if isinstance(value, np.ndarray):
        value = f"{value.dtype}{value.shape}".encode() + np.ascontiguousarray(value).tobytes()
    elif not isinstance(value, bytes):
        value = repr(value).encode()
    return hashlib.sha256(value).hexdigest()[:16]


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options)))
