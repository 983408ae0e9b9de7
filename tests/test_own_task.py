"""Tasks of other packages than ours: of two bags, with a condition of a class of their own, or of no use at all."""

import pickle
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from baggie.collect import collect, scripted
from baggie.collect.recording import Recording, open_simulated_cell
from baggie.collect.scripted import Scripted
from baggie.errors import BaggieError, DataError, UsageError
from baggie.evaluation.choices_of_scene import Done, replayed
from baggie.evaluation.marked_pictures import Region
from baggie.evaluation.predictions import Prediction, RecordedView, save_worst_pictures
from baggie.evaluation.setup import UNKNOWN, camera_size, fingerprint
from baggie.geometry import PlanarPose
from baggie.learning.split import Split
from baggie.operator import Nobody
from baggie.options.collecting import CollectOptions
from baggie.options.evaluating import EvaluateOptions
from baggie.registry import TASKS
from baggie.sim.bag import FULL_HEIGHT_M, Bag
from baggie.sim.cell import PICTURE_SIZE
from baggie.sim.objects import Block, stand
from baggie.tasks.conditions import Condition, InSlots, Score, Slot, State, all_hold, remaining
from baggie.tasks.demonstrator import next_action, varied_action
from baggie.tasks.layout import scatter
from baggie.tasks.task import Scene, Setting, Task
from baggie.types import PickPlace, Plan
from baggie.workcell.simulated import SimulatedWorkcell
from helpers.synthetic import make_attempt

BAGS = (Bag(name="blue bag"), Bag(name="green bag"))
BESIDE = InSlots(("green bag",), (Slot(PlanarPose(0.0, 0.13), 0.0, frame="blue bag"),), weight=1.0)
AT = {"blue bag": PlanarPose(0.5, -0.1, 0.3), "green bag": PlanarPose(0.45, 0.2)}
NAME = "bag-beside-bag"


@dataclass(frozen=True)
class LeftOf:
    """One thing lies to the left of another."""

    one: str
    other: str
    weight: float = 1.0

    def share(self, state: State) -> float:
        return float(self.holds(state))

    def holds(self, state: State) -> bool:
        return state.places[self.one].y > state.places[self.other].y + 0.1

    def next_action(self, state: State, _tool: str) -> PickPlace:
        one, other = state.places[self.one], state.places[self.other]
        return PickPlace(one, PlanarPose(other.x, other.y + 0.15))


class Stuck(LeftOf):
    """Never so, and without a way to make it so."""

    def __init__(self) -> None:
        super().__init__("blue bag", "red bag")

    def holds(self, _state: State) -> bool:
        return False


def _task(*conditions: Condition, tool="hand", things=BAGS, at=AT) -> Task:
    return Task(
        name=NAME,
        instruction="Lay one beside the other.",
        tool=tool,
        view="camera",
        things=things,
        draw_scene=lambda _rng, _setting: Scene(things, at, conditions),  # no process can be sent this
        max_steps=3,
        object_symmetry=4,
    )


def known(monkeypatch: pytest.MonkeyPatch, task: Task) -> None:
    """As an entry point would make it."""
    monkeypatch.setitem(TASKS._own, task.name, "an.other:PACKAGE")
    monkeypatch.setitem(TASKS._found, task.name, task)


def _recording(task: Task) -> Recording:
    return Recording(task.instruction, seed=0, cell=0, size=PICTURE_SIZE)


def test_a_worker_is_told_a_task_by_its_name_however_its_scenes_are_drawn(
    monkeypatch, tmp_path: Path
) -> None:
    task = _task(BESIDE)
    known(monkeypatch, task)
    demonstrator = Scripted(CollectOptions(tmp_path, task=task.name), open_simulated_cell)
    assert pickle.loads(pickle.dumps(demonstrator.open_worker(_recording(task)))) is not None


def test_a_scene_in_which_nothing_is_to_be_done_is_one_line(monkeypatch) -> None:
    task = _task(BESIDE)
    known(monkeypatch, task)
    monkeypatch.setattr(scripted, "demonstrate", lambda *_: [])
    show = scripted._open_worker(lambda _number: None, task.name, _recording(task), Nobody())
    with pytest.raises(BaggieError, match=r"in every scene of bag-beside-bag, got demonstration 3"):
        list(show(3))


def test_what_drawing_a_scene_raises_is_one_line_with_the_tasks_name() -> None:
    def refuse(_rng: np.random.Generator, _setting: Setting) -> Scene:
        raise ValueError("two\nlines")

    rng = np.random.default_rng(0)
    said = "expected no error in draw_scene of the task bag-beside-bag, got ValueError: two lines; mend it"
    with pytest.raises(BaggieError, match=said):
        replace(_task(), draw_scene=refuse).draw(rng)
    crowded = replace(_task(), draw_scene=lambda *_: scatter(dict.fromkeys("abcdefghi", 0.15), rng))
    with pytest.raises(BaggieError, match="expected things that find room") as told:
        crowded.draw(rng)
    assert "draw_scene" not in str(told.value), "what is a line already is passed on"


def test_what_a_condition_raises_is_one_line_with_the_tasks_name() -> None:
    right, wrong = LeftOf("blue bag", "green bag"), LeftOf("blue bag", "red bag")
    state = State.of({name: pose.upright(0.02) for name, pose in AT.items()})
    good, bad, stuck = _task(right, wrong, Stuck()).draw(np.random.default_rng(0)).conditions
    assert (good.weight, good.share(state), good.holds(state)) == (1.0, 0.0, False)
    assert good.next_action(state, "hand") == right.next_action(state, "hand")
    asked = {
        "share": lambda: Score((bad,)).count(state),
        "holds": lambda: all_hold((bad,), state),
        "next_action": lambda: next_action((stuck,), state),
    }
    for name, ask in asked.items():
        said = rf"\.{name} of the task bag-beside-bag, got KeyError: 'red bag'; mend it"
        with pytest.raises(BaggieError, match=said):
            ask()


def test_only_a_cup_takes_things_anywhere(monkeypatch, tmp_path: Path) -> None:
    known(monkeypatch, _task(BESIDE))
    with pytest.raises(UsageError, match="no --style with --task bag-beside-bag"):
        CollectOptions(tmp_path, task=NAME, style="varied").check()


def test_a_condition_without_slots_is_shown_as_it_says_and_in_its_turn() -> None:
    blocks, at = (Block("a"), Block("b")), {"a": PlanarPose(0.5, -0.2), "b": PlanarPose(0.5, 0.0)}
    left, slots = LeftOf("a", "b"), InSlots(("b",), (Slot(PlanarPose(0.4, 0.1), 0.02),), weight=0.5)
    scene = Scene(blocks, at, (left, slots))
    state = State.of({name: pose.upright(0.02) for name, pose in at.items()})
    assert remaining(scene.conditions, state) is None
    assert varied_action(scene, state, np.random.default_rng(0)) == left.next_action(state, "cup")
    step = Done(left.next_action(state, "cup"), None, 0.5)
    assert not list(replayed(scene, [step]))  # nor is anything said of how right a plan was
    there = State.of(state.poses | {"a": PlanarPose(0.5, 0.3).upright(0.02)})
    waiting = remaining(scene.conditions, there)
    assert waiting is not None
    assert waiting.condition is slots


def test_of_a_bag_it_is_not_told_what_was_as_right() -> None:
    scene = Scene(BAGS, AT, (BESIDE,))
    assert not list(replayed(scene, [Done(PickPlace(AT["green bag"], AT["blue bag"]), None, 1.0)]))


def test_a_slot_may_be_in_the_frame_of_a_bag() -> None:
    poses = {name: pose.upright(FULL_HEIGHT_M / 2) for name, pose in AT.items()}
    action = BESIDE.next_action(State.of(poses), "hand")
    assert action is not None
    np.testing.assert_allclose(action.place.xy, (AT["blue bag"] @ PlanarPose(0.0, 0.13)).xy, atol=1e-9)
    assert BESIDE.holds(
        State.of(poses | {"green bag": poses["blue bag"] @ PlanarPose(0.0, 0.13).upright(0.0)})
    )


def test_a_task_in_which_nothing_can_be_carried_is_one_line() -> None:
    with pytest.raises(BaggieError, match="something that can be carried among the things of bag-beside-bag"):
        _task(BESIDE, things=(stand(),), at={"stand": AT["blue bag"]})


def test_a_task_in_which_a_cup_meets_what_is_soft_is_one_line() -> None:
    with pytest.raises(BaggieError, match=r"rigid things only in bag-beside-bag.*got blue bag, green bag"):
        _task(BESIDE, tool="cup")


def test_a_policy_that_says_nothing_of_a_camera_sees_the_simulators(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("policy: mine\n")
    assert camera_size(EvaluateOptions(str(tmp_path), tmp_path / "out")) == PICTURE_SIZE


def test_a_policy_without_weights_is_another_once_it_is_saved_anew(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("policy: mine\n")
    (tmp_path / "map.yaml").write_text("1\n")
    (tmp_path / "evaluation").mkdir()
    before = fingerprint(str(tmp_path))
    (tmp_path / "evaluation" / "metrics.json").write_text("{}")
    assert fingerprint(str(tmp_path)) == before != UNKNOWN
    (tmp_path / "map.yaml").write_text("2\n")
    assert fingerprint(str(tmp_path)) not in (before, UNKNOWN)


def test_attempts_without_a_goal_in_the_picture_are_said_to_have_none() -> None:
    nowhere = np.full((4, 2), np.nan)
    attempts = [
        replace(make_attempt(i, np.random.default_rng(i), (160, 90)), box_before=nowhere, box_after=nowhere)
        for i in range(3)
    ]
    with pytest.raises(DataError, match="got 3 that succeeded, none with one"):
        Split.of(attempts, 2, 1)


@pytest.mark.filterwarnings("error")
def test_a_picture_in_which_nobody_looked_for_the_thing_has_no_marks(tmp_path: Path) -> None:
    nowhere = np.full((4, 2), np.nan)
    attempt = replace(
        make_attempt(0, np.random.default_rng(0), (160, 90)), box_before=nowhere, box_after=nowhere
    )
    planned = Prediction(0, attempt.commanded, {"labels": attempt.outcome.executed}, 1.0)
    view = RecordedView(Region(0, 0, 160, 90), None)

    class Silent:
        def plan(self, *_: object) -> object:
            return Plan(attempt.commanded)

    record = save_worst_pictures(tmp_path, view, attempt, planned, Silent())
    assert (tmp_path / record["picture"]).exists()


def test_a_scenery_that_a_task_does_not_draw_is_refused():
    with pytest.raises(BaggieError, match=f"scenery plain with the task {NAME}, whose scenes do not vary"):
        SimulatedWorkcell(0, _task(BESIDE), scenery="varied", pictures=False)


def test_a_simulated_workcell_in_a_file_has_the_usual_task(tmp_path, monkeypatch):
    monkeypatch.setitem(TASKS._found, NAME, replace(_task(), has_goal=True))
    monkeypatch.setattr(type(TASKS), "__contains__", lambda self, name: name in (NAME, "bag-place"))
    file = tmp_path / "cell.yaml"
    file.write_text("arm: sim\n")
    with pytest.raises(BaggieError, match=r"expected --task bag-place with .*cell\.yaml"):
        collect(CollectOptions(tmp_path / "out", task=NAME, workcell=file), operator=Nobody())
    assert not (tmp_path / "out").exists()
