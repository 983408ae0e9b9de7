"""What words people may give, and what is meant unless they say otherwise, where several rooms have to know it."""

from __future__ import annotations

from typing import Literal

USUAL_TASK = "bag-place"
"""The task where none is named."""

Scenery = Literal["plain", "light", "varied", "unseen-bag", "unseen", "two-bags"]
"""What a scene with bags shows."""
CollectedScenery = Literal["plain", "varied"]
"""What a recording may show: what others show is kept for evaluation."""
CollectedStyle = Literal["plain", "varied"]
"""How whoever demonstrates goes about it."""
GoalKind = Literal["virtual", "turned", "card"]
"""How a goal is given: marked square to the workspace, marked at any angle, or by a card that really lies there."""
DrawnStyle = Literal["outline", "solid"]
"""How a goal is drawn or printed."""

Backbone = Literal["small", "resnet18"]
"""What sees, in a `keypoint` policy."""
Statistics = Literal["running", "picture"]
"""What a trained network normalises by: averages over its training, as published, or each picture's own."""
Preset = Literal["fast", "paper"]
"""Of a `transporter` policy: `fast` is ours; `paper` has the published sizes."""

COLOR_MASK, ORACLE = "color-mask", "oracle"
"""Policies that nobody has to train: the one that goes by a bag's colour, the one that knows the truth."""

CARD_COLOR = (26, 140, 51)
"""RGB of the cards that `baggie print-target goal-card` makes."""
HAND_MARKER = "aruco:DICT_4X4_50:0:0.060"
"""On the plate in front of the fingertips, for `image-to-robot` and `check`."""
TABLE_MARKER = "aruco:DICT_4X4_50:1:0.060"
"""Laid on the table, to be touched by `check`."""
BOARD = "charuco:12x8:0.032:0.024:DICT_4X4_50"
"""For everything else: held in front of the camera, laid on the table. As large as A3 allows: with a board half as
large the focal length is three times as uncertain, and the camera's angle four times."""
HAND_BOARD = "charuco:5x4:0.020:0.015:DICT_4X4_50"
"""On the plate in the hand, for `hand-eye`."""
