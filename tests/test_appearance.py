"""Other cloths, tables and clutter: the object stays where it is and as it is shaded."""

import numpy as np
import pytest

from baggie.data.appearance import object_mask, random_look, turned, without_object
from baggie.vision.color_mask import find_bag
from synthetic import make_attempt

ATTEMPT = make_attempt(3, np.random.default_rng(3), (320, 180), depth=False)
PICTURE = ATTEMPT.before.color
MASK = object_mask(PICTURE, ATTEMPT.box_before)


def test_the_mask_is_on_the_object():
    v, u = np.nonzero(MASK > 0.5)
    assert [u.mean(), v.mean()] == pytest.approx(ATTEMPT.box_before.mean(axis=0), abs=1.0)
    red = PICTURE.astype(int)[..., 0] - PICTURE.astype(int)[..., 1]
    assert MASK[red > 80].min() > 0.4
    assert MASK[red < 10].mean() < 0.02


def test_a_gray_object_is_taken_for_its_box():
    gray = np.repeat(PICTURE.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)
    mask = object_mask(gray, ATTEMPT.box_before)
    v, u = np.nonzero(mask)
    assert [u.mean(), v.mean()] == pytest.approx(ATTEMPT.box_before.mean(axis=0), abs=1.0)


def test_a_table_without_the_object_has_nothing_red():
    empty = without_object(PICTURE, MASK).astype(int)
    assert (empty[..., 0] - empty[..., 1]).max() < 40
    beside = MASK == 0
    assert (np.abs(empty - PICTURE)[beside].mean(axis=0) < 1).all()


@pytest.mark.parametrize("angle", [-0.6, 0.4, 1.2])
def test_an_object_is_turned_from_u_towards_v_about_its_middle(angle):
    v, u = np.nonzero(MASK > 0.5)
    middle = np.array([u.mean(), v.mean()])
    corner = ATTEMPT.box_before[np.linalg.norm(ATTEMPT.box_before - middle, axis=1).argmax()] - middle
    picture, mask = turned(PICTURE, without_object(PICTURE, MASK), MASK, middle, angle)
    v, u = np.nonzero(mask > 0.5)
    assert [u.mean(), v.mean()] == pytest.approx(middle, abs=0.6)
    c, s = np.cos(angle), np.sin(angle)
    there = np.round(middle + 0.75 * np.array([[c, -s], [s, c]]) @ corner).astype(int)
    red = picture[there[1], there[0]].astype(int)
    assert red[0] - red[1] > 60
    before, after = find_bag(PICTURE, (200, 40, 40)), find_bag(picture, (200, 40, 40))
    assert before is not None
    assert after is not None
    assert after.area_px == pytest.approx(before.area_px, rel=0.12), "nothing is left where it was"


def test_looks_differ_and_follow_from_their_seed():
    looks = [random_look(np.random.default_rng(seed), PICTURE, MASK) for seed in (1, 1, 2)]
    assert np.array_equal(looks[0], looks[1])
    assert not np.array_equal(looks[0], looks[2])
    assert looks[0].dtype == np.uint8
    assert looks[0].shape == PICTURE.shape


def test_cloths_take_all_hues():
    inside = MASK > 0.99
    colors = np.array(
        [random_look(np.random.default_rng(seed), PICTURE, MASK)[inside].mean(axis=0) for seed in range(40)]
    )
    strongest = colors.argmax(axis=1)
    assert set(strongest.tolist()) == {0, 1, 2}


def test_clutter_never_covers_the_object():
    """Even where everything beside it may be covered, the shading of the cloth shows through."""
    inside = MASK > 0.99
    gray = PICTURE[inside].mean(axis=1)
    for seed in range(20):
        look = random_look(np.random.default_rng(seed), PICTURE, MASK)[inside].mean(axis=1)
        bright, dark = gray > np.percentile(gray, 80), gray < np.percentile(gray, 20)
        assert look[bright].mean() >= 0.9 * look[dark].mean()
