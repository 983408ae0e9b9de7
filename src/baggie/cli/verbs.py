"""What `baggie` can be told: a table of names. Only what a command is about is imported, when it is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Verb:
    """A command: what it is for, what may be said about it, and what does it."""

    summary: str
    """In a line."""
    examples: tuple[str, ...]
    options: str
    """`module:attribute` of its options' dataclass; or, where there is a `choice`, of a registry of such."""
    does: str
    """`module:function` that takes the options."""
    shows: str | None = "baggie.cli.main:show"
    """`module:function` that takes what came of it, and whether that is to be JSON; None where nothing does."""
    choice: str | None = None
    """The option that says by a name which class of options it is; the registry's first name unless given."""
    more: str = ""
    """What else its help says."""


@dataclass(frozen=True)
class Group:
    """A command of several verbs."""

    summary: str
    examples: tuple[str, ...]
    verbs: Mapping[str, Verb | Group]


_COLLECTING, _EVALUATING = "baggie.options.collecting", "baggie.options.evaluating"
_SETTING_UP, _COMMISSIONING = "baggie.options.commissioning", "baggie.commissioning"

_WORKCELL = Group(
    "Write down a workcell, or show what is written.",
    ("baggie workcell new cell.yaml",),
    {
        "new": Verb(
            "Write a workcell file, from what you answer to a few questions.",
            ("baggie workcell new cell.yaml",),
            f"{_SETTING_UP}:NewWorkcellOptions",
            f"{_COMMISSIONING}.new_workcell:new_workcell",
        ),
        "show": Verb(
            "Everything a workcell file says, and what follows from that or is left to the defaults.",
            ("baggie workcell show cell.yaml",),
            f"{_SETTING_UP}:ShowWorkcellOptions",
            "baggie.workcell.workcell_file:shown_workcell",
        ),
    },
)
_CALIBRATE = Group(
    "Calibrate a workcell step by step, and check that it still holds. Each can be stopped and goes on when repeated.",
    ("baggie calibrate intrinsics --from pictures --out camera.yaml",),
    {
        "intrinsics": Verb(
            "The camera's own matrix and lens distortion, from pictures of a board.",
            (
                "baggie calibrate intrinsics --from pictures --board charuco:7x5:0.030:0.021:DICT_4X4_50 --out "
                "camera.yaml",
            ),
            f"{_SETTING_UP}:IntrinsicsOptions",
            f"{_COMMISSIONING}.intrinsics:calibrate_intrinsics",
        ),
        "image-to-robot": Verb(
            "From pixels straight to the robot's frame: the arm drives a marker over the workspace and looks.",
            ("baggie calibrate image-to-robot --intrinsics camera.yaml --out image-to-robot.yaml",),
            f"{_SETTING_UP}:ImageToRobotOptions",
            f"{_COMMISSIONING}.image_to_robot:calibrate_image_to_robot",
        ),
        "camera-to-world": Verb(
            "Where the camera is, from a target of known size that lies on the table.",
            ("baggie calibrate camera-to-world --intrinsics camera.yaml --out camera-to-world.yaml",),
            f"{_SETTING_UP}:CameraToWorldOptions",
            f"{_COMMISSIONING}.poses:calibrate_camera_to_world",
        ),
        "robot-to-world": Verb(
            "Where the robot is, by touching points of the target on the table; with --camera-to-world, both composed.",
            (
                "baggie calibrate robot-to-world --camera-to-world camera-to-world.yaml --out robot-to-world.yaml",
            ),
            f"{_SETTING_UP}:RobotToWorldOptions",
            f"{_COMMISSIONING}.poses:calibrate_robot_to_world",
        ),
        "hand-eye": Verb(
            "Camera and hand together, from a board seen at many poses of the arm; live, or from a recording made "
            "elsewhere.",
            ("baggie calibrate hand-eye --from recording --out hand-eye.yaml",),
            f"{_SETTING_UP}:HandEyeOptions",
            f"{_COMMISSIONING}.poses:calibrate_hand_eye",
        ),
        "check": Verb(
            "How far off a calibration is today: the arm visits points it was not made from, and touches a marker.",
            ("baggie calibrate check --map image-to-robot.yaml",),
            f"{_SETTING_UP}:CheckOptions",
            f"{_COMMISSIONING}.check:check_calibration",
        ),
    },
)
BAGGIE = Group(
    "A robot that teaches itself to pick up and place soft things.",
    ("baggie collect --task bag-place --attempts 300 --seed 0 --cell 0 --out recordings/bags",),
    {
        "collect": Verb(
            "Let the robot make demonstrations by itself, unattended. The same command again goes on where it stopped.",
            ("baggie collect --task bag-place --attempts 300 --seed 0 --cell 0 --out recordings/bags",),
            f"{_COLLECTING}:CollectOptions",
            "baggie.collect:collect",
        ),
        "inspect": Verb(
            "Say what is in a recording, and draw a contact sheet of it.",
            ("baggie inspect recordings/bags",),
            f"{_COLLECTING}:InspectOptions",
            "baggie.data.summary:inspect",
            shows="baggie.cli.main:show_recording",
        ),
        "import-ravens": Verb(
            "Convert demonstrations of the Ravens benchmark into a recording. The same command again goes on.",
            ("baggie import-ravens stack-block-pyramid-train --out recordings/pyramid",),
            f"{_COLLECTING}:ImportOptions",
            "baggie.ravens.adapters:import_ravens",
            more="The folder is one of those that Ravens' demos.py writes, with action, color, depth, info and reward "
            "in it. Its three views become one picture from straight above, each action an attempt, each episode an "
            "episode.",
        ),
        "train": Verb(
            "Teach a policy from a recording. The same command again goes on where it stopped.",
            ("baggie train --policy keypoint --data recordings/bags --out runs/keypoint",),
            "baggie.options.training:TRAININGS",
            "baggie.learning:train",
            choice="policy",
            more="`keypoint` is ours; `regression` the published baseline; `transporter` for precision, on height maps "
            "or a camera's pictures with a map to the robot.",
        ),
        "validate": Verb(
            "Measure pick and place errors, in cm, on attempts a policy never learned from.",
            ("baggie validate --policy runs/keypoint --data recordings/bags --out runs/keypoint/validation",),
            f"{_EVALUATING}:ValidateOptions",
            "baggie.evaluation.validate:validate",
        ),
        "evaluate": Verb(
            "Run the whole loop on scenes nobody has seen, and measure how often the task is done.",
            (
                "baggie evaluate --policy runs/keypoint --task bag-place --episodes 100 --out runs/keypoint/evaluation",
                "baggie evaluate --policy runs/pyramid --task block-pyramid --out runs/pyramid/evaluation",
                "baggie evaluate --policy oracle --task bag-tower --pattern tower:5 --out runs/oracle-tower-5",
            ),
            f"{_EVALUATING}:EvaluateOptions",
            "baggie.evaluation.closed_loop:evaluate",
        ),
        "report": Verb(
            "Put everything known about some runs on one self-contained page.",
            ("baggie report runs/keypoint runs/color-mask --out report.html",),
            f"{_EVALUATING}:ReportOptions",
            "baggie.report.report:report",
            shows="baggie.cli.main:show_page",
        ),
        "export": Verb(
            "Write a trained policy as files that run without PyTorch, and check that it says the same.",
            ("baggie export --policy runs/keypoint --out exported/keypoint",),
            f"{_EVALUATING}:ExportOptions",
            "baggie.policies.export:export",
        ),
        "workcell": _WORKCELL,
        "doctor": Verb(
            "Check a workcell: camera, light, arm, calibrations; then, with leave, move slowly and touch something "
            "firm.",
            ("baggie doctor cell.yaml",),
            f"{_SETTING_UP}:DoctorOptions",
            f"{_COMMISSIONING}.doctor:examine",
            shows="baggie.cli.main:show_findings",
        ),
        "lab": Verb(
            "Run a virtual lab: a simulated workcell that is reached as a real one is. Ctrl-C ends it.",
            ("baggie lab --out lab.yaml",),
            f"{_SETTING_UP}:LabOptions",
            "baggie.lab.web:serve_lab",
            shows=None,
            more="Prints the workcell file that opens it.",
        ),
        "calibrate": _CALIBRATE,
        "print-target": Verb(
            "Make a marker, a board or a goal card as a PDF at true size.",
            ("baggie print-target board --out board.pdf",),
            f"{_SETTING_UP}:PrintOptions",
            "baggie.vision.printing:print_to_pdf",
        ),
    },
)
