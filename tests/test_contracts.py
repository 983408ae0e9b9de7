"""Every task that there is keeps the contract that a task of somebody else's has to keep."""

import json
import os
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

import baggie
from baggie.collect.task_contract import check_task
from baggie.registry import TASKS

OUTSIDE = Path(__file__).parents[1] / "examples" / "outside_package"
IN_ANOTHER_PACKAGE = """
import sys
from pathlib import Path

import baggie, gymnasium
from baggie.cameras.camera import check_camera
from baggie.cli.main import main
from baggie.collect.task_contract import check_task
from baggie.policies.base import check_policy
from baggie.registry import TASKS
from baggie.robot.contract import check_arm
from baggie_tray.policy import HighestPolicy

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    check_task(TASKS["two-on-a-tray"], folder / "checked")
    env = gymnasium.make("baggie/TwoOnATray-v0")
    env.reset(seed=0)
    HighestPolicy((0.5, 0.0)).save(folder / "highest")
    policy = baggie.load_policy(folder / "highest")
    seen = env.unwrapped._workcell.look()
    check_policy(policy, seen)
    env.close()
    words = f"--task two-on-a-tray --workers 1 --out {folder}"
    assert main(f"collect --attempts 1 {words}/recording".split()) == 0
    for tried in ("oracle", folder / "highest"):
        assert main(f"evaluate --policy {tried} --episodes 1 --film 0 {words}/{Path(tried).name}-tried".split()) == 0
    file = folder / "cell.yaml"
    file.write_text("arm: {kind: tray-arm, reach_m: 0.8}\\ncamera: {kind: tray-camera}\\n")
    cell = baggie.open_workcell(file)
    check_arm(cell.arm)
    check_camera(cell.camera)
    assert main(["workcell", "show", str(file)]) == 0
"""


LONG = ("bag-pyramid", "bag-layers")
"""Of many bags, each of which takes its seconds."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in LONG else []) for name in TASKS.names()]
)
def test_every_task_keeps_its_contract(name: str, tmp_path: Path) -> None:
    assert TASKS[name].name == name
    check_task(TASKS[name], tmp_path / "recording")


def test_a_task_in_which_nothing_counts_is_found_out(tmp_path: Path) -> None:
    pyramid = TASKS["block-pyramid"]

    def nothing_counts(rng, setting):
        return replace(pyramid.draw_scene(rng, setting), conditions=())

    with pytest.raises(AssertionError, match="something counts"):
        check_task(replace(pyramid, draw_scene=nothing_counts), tmp_path)


def test_a_task_whose_scenes_are_all_alike_is_found_out(tmp_path: Path) -> None:
    pyramid = TASKS["block-pyramid"]
    scene = pyramid.draw_scene.__globals__["_draw"]

    def always(_rng, setting):
        import numpy as np

        return scene(np.random.default_rng(0), setting)

    with pytest.raises(AssertionError, match="another stream"):
        check_task(replace(pyramid, draw_scene=always), tmp_path)


def test_what_another_package_has_works_everywhere(tmp_path: Path) -> None:
    info = (
        tmp_path / "baggie_tray-0.1.0.dist-info"
    )  # what installing the package would leave, without a network
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: baggie-tray\nVersion: 0.1.0\n")
    groups = tomllib.loads((OUTSIDE / "pyproject.toml").read_text())["project"]["entry-points"]
    lines = [
        f"[{group}]\n" + "\n".join(f"{k} = {v}" for k, v in points.items())
        for group, points in groups.items()
    ]
    (info / "entry_points.txt").write_text("\n".join(lines))
    path = os.pathsep.join([str(tmp_path), str(OUTSIDE / "src"), str(Path(baggie.__file__).parents[1])])
    script = tmp_path / "outside.py"
    script.write_text(IN_ANOTHER_PACKAGE)
    done = subprocess.run(
        [sys.executable, script, tmp_path],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    strict = json.loads((tmp_path / "oracle-tried" / "metrics.json").read_text())["success"]["rate"]
    assert strict == 1.0
