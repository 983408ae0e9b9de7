"""Adapters to the Ravens benchmark: its recordings become ours, each action an attempt; a policy its agent."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from baggie.data.summary import inspect_dataset
from baggie.data.writer import DatasetWriter
from baggie.errors import BaggieError, DataError, UsageError
from baggie.geometry import FloatArray, Grid, PlanarPose, wrap_angle
from baggie.operator import Operator, TerminalOperator, progress
from baggie.options.collecting import ImportOptions
from baggie.policies.memory import Planner, remembering
from baggie.ravens.episode import RAVENS_CAMERAS, RavensPose, fused, planar_to_pose
from baggie.ravens.format import RavensAction, RavensEpisode, RavensFolder, pose_to_planar
from baggie.types import Attempt, Observation, Outcome, PickPlace

_NOWHERE = np.full((4, 2), np.nan)


def import_ravens(options: ImportOptions, *, operator: Operator | None = None) -> dict[str, Any]:
    """Convert all episodes of a Ravens folder; the recording's summary, ready for JSON.

    The person at the terminal is told how far it is, unless `operator` is given.
    Raises `DataError` when the folder is none of Ravens', an action tilts the object, two episodes have the same
    number, or `options.out` holds another recording; what was converted before stays. Raises `KeyboardInterrupt`, with
    how to go on as its message, when stopped.
    """
    folder, grid = options.folder, _grid(options)
    source = RavensFolder(folder)
    rows, columns = grid.shape
    _check_numbers(source)
    with DatasetWriter(
        options.out,
        task=options.task or _words(folder),
        robot_type="Ravens' UR5",
        picture_size=(columns, rows),
        collection={"ravens": Path(folder).resolve().name, "grid": asdict(grid)},
    ) as writer:
        try:
            _convert(source, writer, grid, operator or TerminalOperator())
        except KeyboardInterrupt:
            begun = f"{len(writer.episodes)} of {len(source)} episodes begun"
            raise KeyboardInterrupt(f"interrupted with {begun}; go on with: {options.command()}") from None
    return inspect_dataset(options.out)


def _grid(options: ImportOptions) -> Grid:
    """Make the grid of the pictures. Raises `UsageError` for bounds that make none."""
    try:
        return Grid(options.x, options.y, options.z, options.pixel_m)
    except BaggieError as error:
        raise UsageError(str(error)) from None


def _convert(source: RavensFolder, writer: DatasetWriter, grid: Grid, operator: Operator) -> None:
    recorded = writer.episodes
    # They are recorded one after the other, so all but the last of them are whole.
    last = next(reversed(recorded), None)
    numbers = [number for number, _ in source.episode_ids]
    missing = [i for i, number in enumerate(numbers) if number not in recorded]
    if last in numbers:
        missing.insert(0, numbers.index(last))
    attempt_id = max(writer.attempt_ids, default=-1) + 1
    with progress(operator, "converting episodes", len(source), len(source) - len(missing)) as advance:
        for i in missing:
            episode = source[i]
            for attempt in attempts_of(
                episode, writer.settings.task, grid, attempt_id, recorded.get(episode.number, 0)
            ):
                writer.append(attempt)
                attempt_id += 1
            advance()


def attempts_of(
    episode: RavensEpisode, task: str, grid: Grid, first_id: int = 0, first_step: int = 0
) -> Iterator[Attempt]:
    """An episode's actions from `first_step` on as attempts; ids count from `first_id`.

    Only the last has a picture after: that of the others is the next one's picture before. Ravens does not say which
    object was meant, nor whether the cup held it, so there is no truth and no failure. Raises `DataError` for an action
    that tilts the object.
    """
    for step in range(first_step, len(episode.actions)):
        action = planar(episode.actions[step])
        picked, placed = episode.actions[step]
        last = step == len(episode.actions) - 1
        yield Attempt(
            attempt_id=first_id + step - first_step,
            task=task,
            before=fused(episode.color[step], episode.depth[step], grid),
            after=fused(episode.color[-1], episode.depth[-1], grid) if last else None,
            commanded=action,
            outcome=Outcome(action, pick_z_m=picked.xyz[2], place_z_m=placed.xyz[2]),
            box_before=_NOWHERE,
            box_after=_NOWHERE,
            seed=episode.seed,
            episode=episode.number,
            step=step,
            reward=float(episode.rewards[step + 1]),
        )


def planar(action: RavensAction) -> PickPlace:
    """The action on the table. Raises `DataError` when it tilts the object.

    The yaws are those of Ravens' tool. As everywhere, the object turns by the difference of the two; that of the
    pick is 0 in the demonstrations.
    """
    return PickPlace(pose_to_planar(action.pose0), pose_to_planar(action.pose1))


def _words(folder: Path) -> str:
    """The task in words, as the folder names it: `stack-block-pyramid-train` -> `stack block pyramid`."""
    return re.sub("-(train|val|test)$", "", Path(folder).resolve().name).replace("-", " ")


def _check_numbers(source: RavensFolder) -> None:
    for number, times in Counter(number for number, _ in source.episode_ids).items():
        if times > 1:
            raise DataError(
                f"expected each episode in {source.path} to have a number of its own, got {times} of {number}; "
                "rename them in all folders"
            )


RavensActionArrays = dict[str, tuple[FloatArray, FloatArray]]
"""`pose0` (the pick) and `pose1` (the place), each `(3,)` xyz in metres and `(4,)` quaternion x, y, z, w."""


class RavensAgent:
    """What Ravens' environment and its test script call an agent.

    agent = RavensAgent(Policy.from_pretrained("runs/pyramid"))
    observation, reward, done, info = env.step(agent.act(observation, info))

    It remembers what it did in an episode (`baggie.policies.memory`); `begin` begins the next one.
    """

    def __init__(self, policy: Planner, grid: Grid | None = None) -> None:
        """`grid`: of the pictures that the policy has learned from; Ravens' own unless given."""
        self._memory = remembering(policy)
        self._grid = grid or Grid()

    def begin(self) -> None:
        """Forget the episode before; a scene that is another one is noticed without."""
        self._memory.begin()

    def act(self, obs: Mapping[str, Sequence[Any]], info: Any = None, goal: Any = None) -> RavensActionArrays:
        """The next action.

        `obs` is Ravens' own: `color`, 3 x `(480, 640, 3)` uint8 RGB, and `depth`, 3 x `(480, 640)` metres along the
        optical axis. The policy sees them fused, nothing else; `info` and `goal` are there because Ravens hands them
        over, and are not looked at. As in Ravens, the cup is not turned for the pick, the place is turned by as much as
        the object is to turn, and heights are those of the map at pick and place.

        Raises `BaggieError` where the policy cannot tell, plans a pose outside the map, or `obs` is another robot's.
        """
        seen = fused(*_views(obs), self._grid)
        action = self._memory.plan(seen).action
        pick, place = action.pick, action.place
        turned = wrap_angle(place.yaw - pick.yaw)
        poses = {"pose0": PlanarPose(pick.x, pick.y), "pose1": PlanarPose(place.x, place.y, turned)}
        return {name: _arrays(planar_to_pose(pose, _z_at(seen, pose))) for name, pose in poses.items()}


def _views(obs: Mapping[str, Sequence[Any]]) -> tuple[list[Any], list[Any]]:
    """Colours and depths by camera, as arrays, or one line that says what is wrong."""
    color = [np.asarray(picture) for picture in obs.get("color", ())]
    depth = [np.asarray(picture, np.float32) for picture in obs.get("depth", ())]
    size = RAVENS_CAMERAS[0][0].height, RAVENS_CAMERAS[0][0].width
    got = [picture.shape for picture in (*color, *depth)], {picture.dtype.name for picture in color}
    if got != ([(*size, 3)] * len(RAVENS_CAMERAS) + [size] * len(RAVENS_CAMERAS), {"uint8"}):
        raise BaggieError(
            f"expected the observation of Ravens' three cameras, color {(*size, 3)} uint8 and depth {size} each, got "
            f"{got[0]} of {', '.join(sorted(got[1])) or 'nothing'}; take Ravens' own environment and cameras"
        )
    return color, depth


def _z_at(seen: Observation, pose: PlanarPose) -> float:
    """Height of what the map shows at a pose, in the robot's base frame, metres."""
    assert seen.grid is not None
    assert seen.height is not None
    grid = seen.grid
    if not grid.contains(pose.xy)[0]:
        raise BaggieError(
            f"expected a plan inside the map, x {grid.x[0]} to {grid.x[1]} m and y {grid.y[0]} to {grid.y[1]} m, got "
            f"x {pose.x:.3f}, y {pose.y:.3f}; take a policy that was trained over this grid"
        )
    u, v = np.floor(grid.to_pixels(pose.xy)[0] + 0.5).astype(int)
    return float(seen.height[v, u]) + grid.z[0]


def _arrays(pose: RavensPose) -> tuple[FloatArray, FloatArray]:
    return np.array(pose.xyz), np.array(pose.xyzw)
