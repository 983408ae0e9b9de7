"""Other cloths, tables and clutter: the object stays where it is and as it is shaded."""

import numpy as np
import pytest

from baggie.learning.augmentation import object_mask, random_look, without_object
from helpers.synthetic import make_attempt

ATTEMPT = make_attempt(3, np.random.default_rng(3), (320, 180), depth=False)
PICTURE = ATTEMPT.before.color
MASK = object_mask(PICTURE, ATTEMPT.box_before)
TABLE = without_object(PICTURE, MASK)


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


def test_looks_differ_and_follow_from_their_seed():
    looks = [random_look(np.random.default_rng(seed), PICTURE, TABLE, MASK) for seed in (1, 1, 2)]
    assert np.array_equal(looks[0], looks[1])
    assert not np.array_equal(looks[0], looks[2])
    assert looks[0].dtype == np.uint8
    assert looks[0].shape == PICTURE.shape


def test_cloths_take_all_hues():
    inside = MASK > 0.99
    colors = np.array(
        [
            random_look(np.random.default_rng(seed), PICTURE, TABLE, MASK)[inside].mean(axis=0)
            for seed in range(40)
        ]
    )
    strongest = colors.argmax(axis=1)
    assert set(strongest.tolist()) == {0, 1, 2}


def test_clutter_never_covers_the_object():
    """Even where everything beside it may be covered, the shading of the cloth shows through."""
    inside = MASK > 0.99
    gray = PICTURE[inside].mean(axis=1)
    for seed in range(20):
        look = random_look(np.random.default_rng(seed), PICTURE, TABLE, MASK)[inside].mean(axis=1)
        bright, dark = gray > np.percentile(gray, 80), gray < np.percentile(gray, 20)
        assert look[bright].mean() >= 0.9 * look[dark].mean()
