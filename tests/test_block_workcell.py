from collections.abc import Iterator
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given
from hypothesis import strategies as st

import baggie  # noqa: F401 -- registers the environments
from baggie.cameras.camera import Camera, HeightMapCamera, check_camera
from baggie.errors import BaggieError, CameraError
from baggie.geometry import Grid, PlanarPose
from baggie.gymnasium_ids import id_of
from baggie.registry import TASKS
from baggie.seeds import COLLECTION, EVALUATION, STYLE, generator
from baggie.sim.cell import draw_cell
from baggie.sim.objects import Block
from baggie.sim.renderer import DepthRenderer
from baggie.sim.world import World
from baggie.tasks.conditions import Score, strict_success
from baggie.tasks.layout import REACH
from baggie.types import Observation, PickPlace
from baggie.vision.height_map import RAVENS_DEPTH_CAMERAS
from baggie.workcell.simulated import SimulatedWorkcell, open_simulated
from baggie.workcell.simulated_cameras import SimulatedDepthCamera
from helpers.carries import carries_in, check_reached

GRID = Grid()


@pytest.fixture(scope="module")
def pyramid() -> Iterator[SimulatedWorkcell]:
    cell = open_simulated(0, "block-pyramid")
    yield cell
    cell.close()


@pytest.fixture(scope="module")
def bowls() -> Iterator[SimulatedWorkcell]:
    cell = open_simulated(0, "place-red-in-green")
    yield cell
    cell.close()


def test_its_camera_keeps_the_contract(pyramid: SimulatedWorkcell) -> None:
    check_camera(pyramid.camera)


def test_a_hand_that_swings_on_its_way_down_feels_no_contact_in_the_air() -> None:
    """Near the end of the wrist's range the elbow has to swing, and then all of the hand would jerk."""
    cell = open_simulated(0, "block-insertion", pictures=False)
    cell.reset([EVALUATION, 0, 82])
    outcome = cell.execute(
        PickPlace(PlanarPose(0.41468, 0.316314, 0.0), PlanarPose(0.387997, -0.223895, 3.091883))
    )
    assert outcome.success
    assert outcome.place_z_m is not None
    assert outcome.place_z_m < 0.05  # the L is 4 cm high
    cell.close()


def strict(cell: SimulatedWorkcell) -> bool:
    return strict_success(cell.scene.conditions, cell)


def finish(cell: SimulatedWorkcell) -> Score:
    """Let the demonstrator work until it has nothing left to do; the score."""
    score, rewards = Score(cell.scene.conditions), 0.0
    for _ in range(cell.task.max_steps):
        action = cell.demonstrate()
        if action is None:
            break
        assert cell.execute(action).success
        rewards += score.count(cell.state())
    assert score.total == pytest.approx(rewards)
    return score


@pytest.mark.parametrize("seed", range(2))
def test_pyramids_are_built_strictly_and_fall_by_the_strict_score_alone(
    pyramid: SimulatedWorkcell, seed: int
) -> None:
    pyramid.reset([seed])
    score = finish(pyramid)
    assert score.total == pytest.approx(1.0)
    assert score.done
    assert strict(pyramid)
    if seed:
        return
    world = pyramid.world
    red = world.planar_pose("red")
    world.put("red", PlanarPose(red.x, red.y + 0.25))
    before = world.time
    assert not strict(pyramid)
    assert world.time == before  # no need to wait for that
    assert score.count(pyramid.state()) == 0.0
    assert score.total == 1.0


def test_what_will_not_stay_is_found_out_by_waiting(pyramid: SimulatedWorkcell) -> None:
    pyramid.reset([2])
    finish(pyramid)
    world = pyramid.world
    world.data.qvel[int(world.model.joint("red").dofadr[0])] = 1.0  # in its slot, but on its way
    before = world.time
    assert not strict(pyramid)
    assert world.time == pytest.approx(before + 2.0, abs=0.02)
    assert world.pose("red")[2, 3] < 0.1


@pytest.mark.parametrize("seed", range(2))
def test_red_blocks_end_in_green_bowls_and_nothing_else_moves(bowls: SimulatedWorkcell, seed: int) -> None:
    bowls.reset([seed])
    others = [block.name for block in bowls.scene.blocks if not block.name.startswith("red")]
    before = {name: bowls.world.planar_pose(name) for name in others}
    assert finish(bowls).total == pytest.approx(1.0)
    assert strict(bowls)
    assert others
    assert all(bowls.world.planar_pose(name).distance(pose) < 1e-3 for name, pose in before.items())


def test_boxes_of_many_sizes_are_aligned() -> None:
    cell = open_simulated(0, "align-box-corner", pictures=False)
    sizes = set()
    for seed in range(4):
        cell.reset([seed])
        sizes.add(cell.world.things["box"].size_m)
        assert finish(cell).total == 1.0
        assert strict(cell)
    assert len(sizes) == 4
    with pytest.raises(CameraError, match="pictures=True"):
        cell.look()


@pytest.fixture(scope="module")
def insertion() -> SimulatedWorkcell:
    return open_simulated(0, "block-insertion", pictures=False)


@pytest.mark.parametrize("seed", [10, 28])  # turned to where the wrist would end at its limit
def test_the_l_is_put_into_its_outline_at_the_first_try(insertion: SimulatedWorkcell, seed: int) -> None:
    insertion.reset([COLLECTION, 3, seed])
    action = insertion.demonstrate()
    assert action is not None
    assert action.pick.yaw == 0.0
    assert abs(action.place.yaw) > 2.0
    insertion.arm.park()
    outcome = insertion.execute(action)
    assert outcome.success
    assert outcome.executed.pick.distance(action.pick) < 0.002
    assert outcome.executed.place.distance(action.place) < 0.003
    assert Score(insertion.scene.conditions).count(insertion.state()) == 1.0
    assert insertion.demonstrate() is None
    assert strict(insertion)


@pytest.mark.parametrize("seed", range(2))
def test_in_the_style_of_others_the_l_ends_in_its_outline_too(
    insertion: SimulatedWorkcell, seed: int
) -> None:
    insertion.reset([seed])
    own = insertion.demonstrate()
    for step in range(insertion.task.max_steps):
        action = insertion.demonstrate(generator(STYLE, 0, seed, step))
        if action is None:
            break
        insertion.execute(action)
    assert strict(insertion)
    insertion.reset([seed])
    first = insertion.demonstrate(generator(STYLE, 0, seed, 0))
    assert first == insertion.demonstrate(generator(STYLE, 0, seed, 0))  # by its stream alone
    assert own == insertion.demonstrate() != first


def shown_at(
    observation: Observation, middle: PlanarPose, size_m: tuple[float, ...], top_m: float
) -> np.ndarray:
    """`(N, 2)` pixels (u, v) near a block that are nearer to its top than to the table."""
    assert observation.height is not None
    v, u = np.nonzero(observation.height > top_m / 2)
    pixels = np.c_[u, v].astype(float)
    near = np.linalg.norm(pixels - GRID.to_pixels([middle.xy]), axis=1)
    return pixels[near < (np.hypot(*size_m[:2]) / 2 + 0.006) / GRID.pixel_m]


def test_the_height_map_shows_every_block_where_and_as_high_as_it_is(pyramid: SimulatedWorkcell) -> None:
    for seed in range(3):
        pyramid.reset([20, seed])
        observation = pyramid.look()
        assert observation.height is not None
        assert observation.size == pyramid.camera.size == GRID.shape[::-1]
        assert abs(np.median(observation.height)) < 0.002
        for block in pyramid.scene.blocks:
            pose, top = pyramid.world.planar_pose(block.name), block.size_m[2]
            pixels = shown_at(observation, pose, block.size_m, top)
            off = pixels.mean(axis=0) - GRID.to_pixels([pose.xy])[0]
            assert np.linalg.norm(off) < 0.5
            u, v = pixels.astype(int).T
            assert np.median(observation.height[v, u]) == pytest.approx(top, abs=0.003)
            seen, meant = np.median(observation.color[v, u], axis=0), np.array(block.color, float)
            assert np.corrcoef(seen, meant)[0, 1] > 0.9


def test_the_same_seed_gives_the_same_picture_and_no_two_pictures_are_alike(bowls: SimulatedWorkcell) -> None:
    def look() -> Observation:
        bowls.reset([7])
        return bowls.look()

    first, second = look(), look()
    np.testing.assert_array_equal(first.color, second.color)
    np.testing.assert_array_equal(first.height, second.height)
    assert not np.array_equal(bowls.look().height, second.height)


def test_cameras_of_a_workcell_keep_their_contract(pyramid: SimulatedWorkcell) -> None:
    assert isinstance(pyramid.camera, Camera)
    (front, *_), renderer = pyramid._view._eyes, pyramid._view._eyes[0].renderer
    assert isinstance(front, Camera)
    assert isinstance(renderer, DepthRenderer)
    # Colour and depth of one pass belong together, and noise is what it says.
    quiet = pyramid.world
    rng = np.random.default_rng(0)
    looks = [renderer.look(RAVENS_DEPTH_CAMERAS[0], rng) for _ in range(8)]
    table = np.s_[200:280, 40:120]
    depth = np.std([each.depth[table] for each in looks if each.depth is not None], axis=0)
    color = np.std([each.color[table].astype(float) for each in looks], axis=0)
    assert 0.0008 < depth.mean() < 0.0012
    assert 1.0 < color.mean() < 3.0
    assert looks[0].time == quiet.time


def test_there_is_one_pose_for_each_camera(pyramid: SimulatedWorkcell) -> None:
    with pytest.raises(BaggieError, match="got 2 poses for 3 cameras"):
        HeightMapCamera(pyramid._view._eyes, [np.eye(4)] * 2)
    with pytest.raises(BaggieError, match="one or more"):
        HeightMapCamera([], [])


def test_what_plays_no_part_is_not_seen(bowls: SimulatedWorkcell) -> None:
    seed = next(s for s in range(20) if "red2" not in TASKS["place-red-in-green"].draw(rng_of(s)).poses)
    bowls.reset([seed])
    renderer = bowls._view._eyes[0].renderer
    assert renderer is not None
    bowls.look()
    camera = RAVENS_DEPTH_CAMERAS[0]
    before = renderer.look(camera, rng_of(0))
    bowls.world.put("red2", PlanarPose(0.7, 0.0))  # in full view, were it not hidden
    after = renderer.look(camera, rng_of(0))
    np.testing.assert_array_equal(before.color, after.color)
    bowls.world.model.geom_group[bowls.world.model.geom("red2").id] = 0
    assert not np.array_equal(renderer.look(camera, rng_of(0)).color, before.color)


def rng_of(seed: int) -> np.random.Generator:
    return np.random.default_rng([seed])


def test_a_reshaped_block_is_as_if_built_so() -> None:
    wanted = Block("a", (0.11, 0.06, 0.03), (10, 200, 30))
    cell = draw_cell(0)
    built, reshaped = World(cell, [wanted, Block("b")], "cup"), World(cell, [Block("a"), Block("b")], "cup")
    reshaped.reshape([wanted])
    for part in ("geom_size", "geom_rbound", "geom_aabb", "geom_rgba", "body_mass", "body_subtreemass"):
        np.testing.assert_allclose(getattr(reshaped.model, part), getattr(built.model, part), atol=1e-6)
    for part in ("body_invweight0", "dof_invweight0", "bvh_aabb"):
        np.testing.assert_allclose(getattr(reshaped.model, part), getattr(built.model, part), rtol=1e-4)
    # Inertias may be told about other axes: what counts is that both move alike.
    ends = []
    for world in (built, reshaped):
        world.reset({"a": PlanarPose(0.5, 0.1, 0.4), "b": PlanarPose(0.4, -0.2)})
        tilted = world.pose("a")
        tilted[:3, :3] = tilted[:3, :3] @ [[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]]
        tilted[2, 3] = 0.1
        world.put("a", tilted)
        world.advance(0.16)
        ends.append(world.pose("a"))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-4)


def test_what_cannot_be_reshaped_is_one_line(bowls: SimulatedWorkcell) -> None:
    with pytest.raises(BaggieError, match="got 'nothing'"):
        bowls.world.reshape([Block("nothing")])
    bowl = bowls.scene.fixtures[0]
    with pytest.raises(BaggieError, match="only its colours may change"):
        bowls.world.reshape([replace(bowl, parts=bowl.parts[:2])])


def test_a_lens_that_cannot_be_rendered_is_one_line() -> None:
    front = RAVENS_DEPTH_CAMERAS[0]
    bent = replace(front, intrinsics=replace(front.intrinsics, distortion=np.array([0.1, 0, 0, 0])))
    with pytest.raises(BaggieError, match="'front' to have square pixels"):
        World(draw_cell(0), [Block("a")], "cup", cameras=[bent])


@given(carries_in(REACH), st.sampled_from([1, 2, 4]))
def test_every_action_of_the_environment_is_reached(
    pyramid: SimulatedWorkcell, action: PickPlace, symmetry: int
) -> None:
    pyramid.arm.park()
    check_reached(pyramid, action, symmetry)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_environment_passes_gymnasiums_own_check() -> None:
    check_env(gymnasium.make("baggie/AlignBoxCorner-v0").unwrapped, skip_render_check=True)


def test_the_environment_is_gymnasiums() -> None:
    env = gymnasium.make("baggie/AlignBoxCorner-v0", render_mode="rgb_array")
    observation, _ = env.reset(seed=3)
    action = env.unwrapped._workcell.demonstrate()
    observation, reward, terminated, truncated, info = env.step(action.to_array().astype(np.float32))
    assert (reward, terminated, truncated) == (1.0, True, False)
    assert info["strict_success"]
    assert info["is_success"] is True
    assert info["partial_credit"] == 1.0
    np.testing.assert_array_equal(env.render(), observation["color"])

    env.reset(seed=4)
    nowhere = np.array([5.0, 0, 0, 0.5, 0, 0], np.float32)
    steps = [env.unwrapped.step(nowhere) for _ in range(3)]
    assert [step[1:4] for step in steps] == [(0.0, False, False)] * 2 + [(0.0, False, True)]
    assert "outside the workspace" in steps[0][4]["refused"]
    assert not steps[-1][4]["strict_success"]
    env.close()


def test_every_task_has_its_environment() -> None:
    named = {
        spec.kwargs["task"]: spec.id
        for spec in gymnasium.registry.values()
        if spec.entry_point == "baggie.envs:TaskEnv"
    }
    assert named == {name: id_of(name) for name in TASKS.names()}
    assert named["bag-place"] == "baggie/BagPlace-v0"


def test_a_camera_can_be_anybodys() -> None:
    class Still:
        name, size, intrinsics = "still", (640, 480), RAVENS_DEPTH_CAMERAS[0].intrinsics

        def look(self) -> Observation:
            depth = np.full((480, 640), 0.5, np.float32)
            color = np.full((480, 640, 3), 90, np.uint8)
            return Observation(color, depth, self.intrinsics, time=4.0)

    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[:3, 3] = [0.5, 0.0, 0.6]
    seen = HeightMapCamera([Still()], [down]).look()
    assert seen.time == 4.0
    assert seen.height is not None
    assert seen.height[160, 80] == pytest.approx(0.1, abs=1e-5)
    assert seen.color[160, 80].tolist() == [90, 90, 90]
    assert isinstance(Still(), Camera)
    assert SimulatedDepthCamera.__doc__
