"""Check that LeRobot's own tools work, unmodified, on a dataset written by baggie.

    PYTHONPATH=src .venv-lerobot/bin/python tests/lerobot/check_lerobot.py DIR

Runs in a Python that has `lerobot[training,dataset-viz]==0.6.1`, SciPy and tyro; of baggie it needs only `baggie.data`.
Where DIR is a recording of five episodes or more, that is checked. Otherwise two small ones are drawn and written
below it first: attempts of one step and of several, seen by a camera, and whole demonstrations of several steps,
seen from straight above. Prints a line per check; exit status 1 if one failed.
"""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

_SCRATCH = Path(tempfile.mkdtemp(prefix="check-lerobot-"))
os.environ |= {  # before lerobot is imported: offline, and no cache of an earlier run
    "HF_HUB_OFFLINE": "1",
    "HF_HOME": str(_SCRATCH / "hf"),
    "HF_LEROBOT_HOME": str(_SCRATCH / "home"),
    "WANDB_MODE": "disabled",
}
sys.path.insert(0, str(Path(__file__).parents[1]))
# ruff: noqa: E402

import numpy as np
import torch
from lerobot.datasets.dataset_tools import delete_episodes, merge_datasets, split_dataset
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.scripts.lerobot_dataset_viz import visualize_dataset
from lerobot.utils.feature_utils import dataset_to_policy_features

from baggie.data import Dataset, DatasetWriter, open_dataset
from baggie.data.lerobot import IMAGE
from baggie.errors import DataError
from baggie.geometry import Grid, PlanarPose
from baggie.types import Attempt, Observation, Outcome, PickPlace
from helpers.synthetic import TASK, make_attempt

SCALARS = {
    "cell": "cell",
    "seed": "seed",
    "tries": "tries",
    "grasp_width_m": "grasp_width_m",
    "pick_z_m": "pick_z_m",
}


EXAMPLE = Path(__file__).parents[2] / "examples" / "17_lerobot.py"

Episodes = list[list[int]]
"""The ids of the attempts in each of LeRobot's episodes."""


GRID = Grid(x=(0.3, 0.62), y=(-0.3, 0.3), pixel_m=0.005)
"""Of the pictures from above."""


def write_attempts(root: Path, attempts: int = 13) -> None:
    """A dataset with failures, lost bags, attempts out of order, and episodes of several, one of them not done."""
    rng = np.random.default_rng(0)
    longer = {3: (attempts, 0.5), 7: (attempts + 2, 0.25)}  # written before these; first id and reward each
    with DatasetWriter(root, task=TASK, robot_type="drawn", collection={"seed": 0}) as writer:
        for attempt_id in rng.permutation(attempts).tolist():
            if attempt_id in longer:
                first, reward = longer[attempt_id]
                for step in range(2 if reward == 0.5 else 3):
                    one = make_attempt(first + step, rng)
                    after = None if step == 0 else one.after
                    writer.append(replace(one, after=after, episode=attempt_id, step=step, reward=reward))
            failure = {2: "missed-grasp", 5: "dropped"}.get(attempt_id)
            attempt = make_attempt(attempt_id, rng, failure=failure)
            if attempt_id == 5:
                attempt = replace(attempt, box_after=np.full((4, 2), np.nan), after=None)
            writer.append(attempt)


def write_demonstrations(root: Path, episodes: int = 5, steps: int = 6) -> None:
    """Episodes as `baggie collect --task block-pyramid` writes them; in the last one a step failed, and it ended."""
    rng = np.random.default_rng(0)
    rows, columns = GRID.shape
    nowhere = np.full((4, 2), np.nan)

    def seen() -> Observation:
        height = rng.uniform(0, 0.1, GRID.shape).astype(np.float32)
        return Observation(
            rng.integers(0, 256, (rows, columns, 3)).astype(np.uint8), grid=GRID, height=height
        )

    collection = {"seed": 0, "object_symmetry": 4}
    with DatasetWriter(
        root, task=TASK, robot_type="drawn", picture_size=(columns, rows), collection=collection
    ) as writer:
        for episode in rng.permutation(episodes).tolist():
            count = steps // 2 if episode == episodes - 1 else steps
            for step in range(count):
                pick, place = (
                    PlanarPose(*rng.uniform((0.35, -0.25, -3), (0.6, 0.25, 3)).tolist()) for _ in range(2)
                )
                failed = count < steps and step == count - 1
                action = PickPlace(pick, place)
                attempt = Attempt(
                    attempt_id=episode * steps + step,
                    task=TASK,
                    before=seen(),
                    after=seen() if step == count - 1 else None,
                    commanded=action,
                    outcome=Outcome(action, failure="dropped" if failed else None),
                    box_before=nowhere,
                    box_after=nowhere,
                    episode=episode,
                    step=step,
                    reward=0.0 if failed else 1 / steps,
                )
                writer.append(attempt)


DRAWN = {"attempts": write_attempts, "demonstrations": write_demonstrations}


def expect_equal(dataset: LeRobotDataset, ours: Dataset, episodes: Episodes) -> None:
    """Every frame of a LeRobot dataset is the attempt of ours it should be, and so are its statistics."""
    ids = [attempt_id for episode in episodes for attempt_id in episode]
    assert dataset.num_frames == len(dataset) == len(ids), (len(dataset), len(ids))
    assert dataset.num_episodes == len(episodes), (dataset.num_episodes, len(episodes))
    numbers, rows = ours.numbers(), [ours.attempt_ids.tolist().index(i) for i in ids]
    places = [(number, step) for number, episode in enumerate(episodes) for step in range(len(episode))]
    earned = 0.0
    for index, (row, (number, step)) in enumerate(zip(rows, places, strict=True)):
        frame, attempt = dataset[index], ours[row]
        earned = (earned if step else 0.0) + (attempt.reward or 0.0)
        picture = (frame[IMAGE].permute(1, 2, 0) * 255).round().to(torch.uint8).numpy()
        np.testing.assert_array_equal(picture, attempt.before.color)
        np.testing.assert_array_equal(frame["action"], np.float32(attempt.outcome.executed.to_array()))
        box = np.float32(np.nan_to_num(attempt.box_after.ravel(), nan=-1))
        np.testing.assert_array_equal(frame["observation.state"], box)
        assert frame["annotation.attempt_id"].item() == attempt.attempt_id
        assert frame["next.success"].item() == attempt.outcome.success
        assert frame["next.done"].item() is (attempt.episode is None or earned > 0.999)
        assert frame["annotation.time_us"].item() == round(attempt.time * 1e6)
        for theirs, name in SCALARS.items():
            assert frame[f"annotation.{theirs}"].item() == np.float32(numbers[name][row]), name
        assert frame["task"] == attempt.task
        assert frame["index"].item() == index
        assert frame["episode_index"].item() == number
        assert frame["frame_index"].item() == frame["timestamp"].item() == attempt.step == step
    actions = np.float32(numbers["executed"][rows])
    stats = dataset.meta.stats
    np.testing.assert_allclose(stats["action"]["mean"], actions.mean(axis=0), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(stats["action"]["min"], actions.min(axis=0), rtol=1e-6)
    assert stats["action"]["count"].item() == len(ids)
    pixels = ours.colors(rows).reshape(-1, 3) / 255
    np.testing.assert_allclose(stats[IMAGE]["mean"].ravel(), pixels.mean(axis=0), rtol=1e-5)
    np.testing.assert_allclose(stats[IMAGE]["std"].ravel(), pixels.std(axis=0), rtol=1e-4)


class Checks:
    """The checks, in order; later ones use what earlier ones made."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.scratch = _SCRATCH / root.name
        self.fingerprint = fingerprint(root)
        self.ours = open_dataset(root)
        numbers = self.ours.numbers()
        order = np.lexsort((numbers["step"], numbers["episode_index"]))
        self.ids: list[int] = self.ours.attempt_ids[order].tolist()
        starts = np.flatnonzero(np.diff(numbers["episode_index"][order])) + 1
        self.episodes: Episodes = [part.tolist() for part in np.split(self.ours.attempt_ids[order], starts)]

    def load(self, root: Path | None = None, name: str = "check/attempts") -> LeRobotDataset:
        return LeRobotDataset(name, root=root or self.root)

    def loads_and_equals(self) -> str:
        """LeRobotDataset loads, every frame and every statistic is what baggie reads"""
        dataset = self.load()
        expect_equal(dataset, self.ours, self.episodes)
        actions = np.float32(self.ours.numbers()["executed"])
        pixels = self.ours.colors().reshape(-1, 3) / 255
        for name, q in {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}.items():
            np.testing.assert_allclose(
                dataset.meta.stats["action"][name], np.quantile(actions, q, axis=0), rtol=1e-5, atol=1e-7
            )
            expected = np.quantile(pixels, q, axis=0).reshape(3, 1, 1)
            np.testing.assert_allclose(dataset.meta.stats[IMAGE][name], expected, rtol=1e-6)
        return f"{len(dataset)} frames in {len(self.episodes)} episodes, exact quantiles"

    def policy_features(self) -> str:
        """A policy's inputs and outputs are what they should be, no more"""
        features = dataset_to_policy_features(self.load().meta.features)
        kinds = {name: feature.type.value for name, feature in features.items()}
        assert kinds == {IMAGE: "VISUAL", "observation.state": "STATE", "action": "ACTION"}, kinds
        return ", ".join(kinds)

    def data_loader(self) -> str:
        """A shuffling torch DataLoader with workers yields every attempt once"""
        loader = torch.utils.data.DataLoader(self.load(), batch_size=4, shuffle=True, num_workers=2)
        seen = [i for batch in loader for i in batch["annotation.attempt_id"].tolist()]
        assert sorted(seen) == sorted(self.ids), seen
        return f"{len(seen)} attempts"

    def chunks(self) -> str:
        """The actions that follow a frame are those of its own episode, padded at its end"""
        steps = [0.0, 1.0, 2.0]
        dataset = LeRobotDataset("check/attempts", root=self.root, delta_timestamps={"action": steps})
        executed = dict(zip(self.ours.attempt_ids.tolist(), self.ours.numbers()["executed"], strict=True))
        padded = 0
        places = [(episode, step) for episode in self.episodes for step in range(len(episode))]
        for index, (episode, step) in enumerate(places):
            following = [min(step + int(ahead), len(episode) - 1) for ahead in steps]
            expected = np.float32([executed[episode[place]] for place in following])
            frame = dataset[index]
            np.testing.assert_array_equal(frame["action"], expected)
            pad = [step + int(ahead) >= len(episode) for ahead in steps]
            assert frame["action_is_pad"].tolist() == pad, (index, frame["action_is_pad"], pad)
            padded += sum(pad)
        return f"{len(places)} chunks, {padded} actions padded"

    def trains(self) -> str:
        """lerobot-train makes a checkpoint of ACT"""
        out = self.scratch / "run"
        small = ["chunk_size", "n_action_steps", "n_encoder_layers", "n_vae_encoder_layers"]
        flags = {
            "dataset.repo_id": "check/attempts",
            "dataset.root": self.root,
            "output_dir": out,
            "steps": 3,
            "batch_size": 2,
            "num_workers": 0,
            "wandb.enable": "false",
            "policy.type": "act",
            "policy.device": "cpu",
            "policy.push_to_hub": "false",
            "policy.pretrained_backbone_weights": "null",
            "policy.dim_model": 32,
            "policy.dim_feedforward": 32,
            **{f"policy.{name}": 1 for name in small},
        }
        arguments = [f"--{name}={value}" for name, value in flags.items()]
        command = [sys.executable, "-m", "lerobot.scripts.lerobot_train", *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-3000:]
        weights = list(out.glob("checkpoints/000003/**/model.safetensors"))
        assert len(weights) == 1, weights
        return "3 steps"

    def visualises(self) -> str:
        """lerobot-dataset-viz saves an episode for Rerun"""
        out = self.scratch / "viz"
        dataset = LeRobotDataset("check/attempts", root=self.root, episodes=[1])
        saved = visualize_dataset(dataset, 1, save=True, output_dir=out)
        assert saved is not None
        assert saved.stat().st_size > 10_000, saved
        return f"{saved.name}, {saved.stat().st_size} bytes"

    def deletes(self) -> str:
        """delete_episodes drops these episodes and keeps the others whole"""
        gone = [0, len(self.episodes) // 2, len(self.episodes) - 1]
        result = delete_episodes(
            self.load(), gone, output_dir=self.scratch / "deleted", repo_id="check/deleted"
        )
        kept = [episode for number, episode in enumerate(self.episodes) if number not in gone]
        expect_equal(result, self.ours, kept)
        return f"{len(gone)} gone, {len(kept)} left"

    def splits(self) -> str:
        """split_dataset makes two datasets of all attempts"""
        parts = split_dataset(self.load(), {"train": 0.75, "val": 0.25}, output_dir=self.scratch / "split")
        cut = int(0.75 * len(self.episodes))
        expect_equal(parts["train"], self.ours, self.episodes[:cut])
        expect_equal(parts["val"], self.ours, self.episodes[cut:])
        return f"{cut} + {len(self.episodes) - cut} episodes"

    def merges(self) -> str:
        """merge_datasets joins the parts again, and a recording to itself"""
        parts = [self.load(self.scratch / "split" / name, f"check/{name}") for name in ("val", "train")]
        cut = int(0.75 * len(self.episodes))
        merged = merge_datasets(parts, "check/merged", output_dir=self.scratch / "merged")
        expect_equal(merged, self.ours, self.episodes[cut:] + self.episodes[:cut])
        twice = merge_datasets([self.load(), self.load()], "check/twice", output_dir=self.scratch / "twice")
        expect_equal(twice, self.ours, self.episodes * 2)
        return f"{len(merged)} and {len(twice)} frames"

    def resumes(self) -> str:
        """LeRobotDataset.resume records on; baggie then says what happened instead of misreading"""
        copy = self.scratch / "resumed"
        shutil.copytree(self.root, copy)
        recording = LeRobotDataset.resume("check/attempts", root=copy)
        last = self.load()[len(self.ids) - 1]
        features = recording.meta.features
        automatic = {"timestamp", "frame_index", "episode_index", "index", "task_index"}
        for number in (1000, 1001):
            frame = {
                name: np.asarray(last[name], feature["dtype"]).reshape(feature["shape"])
                for name, feature in features.items()
                if name not in automatic and name != IMAGE
            }
            frame["annotation.attempt_id"] = np.array([number])
            frame[IMAGE] = self.ours[0].before.color
            recording.add_frame(frame | {"task": last["task"]})
            recording.save_episode()
        recording.finalize()
        again = self.load(copy)
        assert len(again) == len(self.ids) + 2
        assert [int(i) for i in again.hf_dataset["annotation.attempt_id"]] == [*self.ids, 1000, 1001]
        picture = (again[len(self.ids)][IMAGE].permute(1, 2, 0) * 255).round().to(torch.uint8).numpy()
        np.testing.assert_array_equal(picture, self.ours[0].before.color)
        np.testing.assert_array_equal(again[0]["action"], self.load()[0]["action"])
        assert again.meta.stats["action"]["count"].item() == len(self.ids) + 2
        expect_data_error(copy)
        return "2 episodes more"

    def example(self) -> str:
        """examples/17_lerobot.py reads it"""
        folder = self.scratch / "example"
        (folder / "demo").mkdir(parents=True)
        (folder / "demo" / "recording").symlink_to(self.root)
        command = [sys.executable, str(EXAMPLE)]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        episodes, batch, _ = done.stdout.splitlines()[-3:]  # before them LeRobot may say something
        assert episodes == f"{len(self.episodes)} episodes, {len(self.ids)} frames"
        return batch

    def leaves_it_alone(self) -> str:
        """None of LeRobot's tools changed the recording"""
        assert fingerprint(self.root) == self.fingerprint
        return f"{len(self.ours)} attempts"


def expect_data_error(root: Path) -> None:
    try:
        open_dataset(root)
    except DataError:
        return
    raise AssertionError("baggie read a dataset that holds episodes it did not record")


def fingerprint(root: Path) -> str:
    files = sorted(path for path in root.rglob("*") if path.is_file())
    return hashlib.sha256(b"".join(str(f).encode() + f.read_bytes() for f in files)).hexdigest()


def main() -> int:
    if len(sys.argv) != 2:
        print(__doc__, file=sys.stderr)
        return 2
    root = Path(sys.argv[1]).absolute()
    logging.disable(logging.WARNING)  # LeRobot says at every turn which video decoders are missing
    if (root / "meta").exists():
        failed = check(root)
    else:
        for name, write in DRAWN.items():
            if not (root / name).exists():
                write(root / name)
        failed = sum(check(root / name) for name in DRAWN)
    shutil.rmtree(_SCRATCH, ignore_errors=True)
    return 1 if failed else 0


def check(root: Path) -> int:
    """Check one recording; how many checks failed."""
    print(f"{root}:", flush=True)
    checks = Checks(root)
    tests: list[Callable[[], str]] = [
        checks.loads_and_equals, checks.policy_features, checks.data_loader, checks.chunks, checks.trains,
        checks.visualises, checks.deletes, checks.splits, checks.merges, checks.resumes, checks.example,
        checks.leaves_it_alone,
    ]  # fmt: skip
    failed = 0
    for test in tests:
        try:
            print(f"ok      {test.__doc__}: {test()}", flush=True)
        except Exception:  # whatever LeRobot raises is a failed check
            failed += 1
            print(f"FAILED  {test.__doc__}", flush=True)
            traceback.print_exc()
    print(f"{len(tests) - failed} of {len(tests)} checks passed", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(main())
