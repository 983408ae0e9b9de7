"""The real workcell and the policy that `baggie evaluate --workcell` names, put together."""

from __future__ import annotations

from baggie.errors import BaggieError
from baggie.evaluation.bench import Bench
from baggie.evaluation.options import EvaluateOptions
from baggie.evaluation.seen_cell import SeenCell
from baggie.evaluation.subjects import open_policy
from baggie.policies import ColorMaskPolicy, LearnedPolicy, Policy
from baggie.policies.as_trained import check_camera
from baggie.policies.exported import ExportedPolicy
from baggie.workcell.config import open_workcell
from baggie.workcell.real import RealWorkcell


def open_bench(options: EvaluateOptions) -> Bench:
    """The workcell of `options.workcell` and the policy; `color-mask` plans with the workcell's own map.

    Raises `BaggieError` for a file that describes no real workcell, or has no map to measure with, and for a policy
    that was trained with another camera.
    """
    assert options.workcell is not None
    opened = open_workcell(options.workcell)
    try:
        if not isinstance(opened, RealWorkcell):
            raise BaggieError(
                f"expected a real arm in {options.workcell}, got a simulated workcell; give its number: --cell N"
            )
        cell = SeenCell(opened, options.workcell)
        policy: Policy
        if options.policy == ColorMaskPolicy.name and options.calibration is None:
            policy = ColorMaskPolicy(cell.image_to_robot, cell.settings.object_color)
        else:
            policy = open_policy(options.policy, options.calibration, options.device)
        if isinstance(policy, LearnedPolicy | ExportedPolicy):
            check_camera(opened.camera.size, policy.camera_size)
    except BaggieError:
        opened.close()
        raise
    return Bench(cell, policy, cell.image_to_robot, cell.find)
