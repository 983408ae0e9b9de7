import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from baggie.cli.main import main, show
from baggie.cli.verbs import BAGGIE, Group, Verb
from baggie.options.training import TRAININGS
from baggie.registry import TASKS, Registry, named

HEAVY = {
    "cv2",
    "gymnasium",
    "huggingface_hub",
    "matplotlib",
    "mujoco",
    "numpy",
    "pyarrow",
    "pydantic",
    "scipy",
    "torch",
}


def commands(told: Verb | Group = BAGGIE, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """All there are, groups and `baggie` itself included."""
    yield words
    for name, verb in told.verbs.items() if isinstance(told, Group) else ():
        yield from commands(verb, (*words, name))


def run(words: list[str]) -> int | str | None:
    """The exit status, however it is reached."""
    try:
        return main(words)
    except SystemExit as stopped:
        return stopped.code or 0


def help_of(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Without what depends on the width of the terminal."""
    assert run([*words, "--help"]) == 0
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("words", list(commands()), ids=" ".join)
def test_every_command_has_help_with_an_example(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert f"Example: {' '.join(('baggie', *words))}" in help_of([*words], capsys)


def test_an_overview_says_what_each_verb_is_for(capsys: pytest.CaptureFixture[str]) -> None:
    said = help_of([], capsys)
    for name, verb in BAGGIE.verbs.items():
        assert f"{name} {verb.summary}" in said
    assert "hand-eye Camera and hand together" in help_of(["calibrate"], capsys)


@pytest.mark.parametrize(
    "arguments",
    [[], ["dance"], ["calibrate"], ["workcell", "dance"], ["collect"], ["train", "--policy", "magic"]],
)
def test_wrong_usage_is_status_2(arguments: list[str]) -> None:
    assert run(arguments) == 2


@pytest.mark.parametrize(
    "words",
    ["--help", "collect --help", "calibrate --help", "calibrate check --help", "--tyro-print-completion bash"]
    + [f"train --policy {name} --help" for name in ("keypoint", "transporter")]
    + ["dance", "train --policy regression --backbone resnet18", "evaluate --policy x --episodes 0 --out x"],
)
def test_what_only_talks_imports_nothing_that_takes_long(words: str) -> None:
    program = (
        "import sys\nfrom baggie.cli.main import main\n"
        "try: main(sys.argv[1:])\nexcept SystemExit: pass\n"
        f"print(*sorted(set(sys.modules) & {HEAVY}), file=sys.stderr)"
    )
    command = [sys.executable, "-c", program, *words.split()]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr.splitlines()[-1] == ""


@pytest.mark.parametrize(
    "module",
    [
        "",
        *(f".options.{room}" for room in ("collecting", "training", "evaluating", "commissioning")),
    ],
)
def test_baggie_itself_and_options_import_nothing_that_takes_long(module: str) -> None:
    program = f"import sys, baggie{module}; print(*(set(sys.modules) & {HEAVY}))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"


def test_a_command_imports_what_it_needs_and_no_simulator_no_pytorch_and_no_plots(tmp_path: Path) -> None:
    from baggie.data import DatasetWriter

    with DatasetWriter(tmp_path / "data", task="t", robot_type="r", collection={}):
        pass
    (tmp_path / "sim.yaml").write_text("arm: sim\n")
    (tmp_path / "real.yaml").write_text("arm: {kind: franka, host: robot}\ncamera: 0\n")
    shown = [f"workcell show {name}.yaml" for name in ("sim", "real")]
    for words in ("inspect data", *shown, "print-target board --out board.pdf"):
        program = (
            "import sys\nfrom baggie.cli.main import main\nassert main(sys.argv[1:]) == 0\n"
            "print(*(set(sys.modules) & {'torch', 'mujoco', 'gymnasium', 'matplotlib'}), file=sys.stderr)"
        )
        command = [sys.executable, "-c", program, *words.split()]
        done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
        assert done.stderr.splitlines()[-1] == "", words


def test_each_policy_has_options_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    only = {"keypoint": "--backbone", "regression": "--statistics", "transporter": "--rearranged"}
    for policy in TRAININGS.names():
        for words in (["--policy", policy], [f"--policy={policy}"]):
            said = help_of(["train", *words], capsys)
            assert [option for option in only.values() if option in said] == [only[policy]]
            assert "--save-every-s" in said
    assert only["keypoint"] in help_of(["train"], capsys)


@pytest.mark.parametrize("verb", ["collect", "evaluate"])
def test_help_says_what_each_task_is(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    said = " ".join(help_of([verb], capsys).replace("│", "").split())
    for name, task in TASKS.all().items():
        assert f"{name}: {task.instruction}" in said


def test_help_says_how_many_steps_each_policy_usually_takes(capsys: pytest.CaptureFixture[str]) -> None:
    from baggie.learning.transporter import _BATCH, _STEPS

    transporter = ", ".join(f"{n:,} of {_BATCH[preset]} for {preset}" for preset, n in _STEPS.items())
    for policy, options in TRAININGS.all().items():
        usually = transporter if policy == "transporter" else f"{named(options.recipe).steps:,}"
        said = help_of(["train", "--policy", policy], capsys).replace("│", "")
        assert f"by default {usually}".replace(" ", "") in said.replace(" ", "")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            "--policy regression --backbone resnet18",
            "expected no --backbone with --policy regression: it is an",
        ),
        (
            "--symmetry 4",
            "with --policy keypoint: it is an option of transporter; leave it out, or take --policy",
        ),
        (
            "--policy transporter --new_looks=0.5",
            "expected no --new-looks with --policy transporter: it is an",
        ),
        (
            "--policy transporter --weights x",
            "an option of keypoint, regression; leave it out, or take --policy",
        ),
    ],
)
def test_an_option_of_another_policy_is_one_line(
    words: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", "--data", "nowhere", "--out", "run", *words.split()]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert said in line


def test_another_package_s_policy_is_trained_by_its_own_options(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    info = tmp_path / "elsewhere-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: elsewhere\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[baggie.trainings]\nguess = elsewhere:Guessing\n")
    (tmp_path / "elsewhere.py").write_text(
        "from dataclasses import dataclass\nfrom baggie.options.training import KeypointTraining\n\n"
        "@dataclass(frozen=True)\nclass Guessing(KeypointTraining):\n"
        '    recipe = "elsewhere:recipe"\n    luck: int = 1\n    """How lucky."""\n'
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(
        "baggie.options.training.TRAININGS",
        Registry("baggie.trainings", {"keypoint": "baggie.options.training:KeypointTraining"}, "policy"),
    )
    assert "--luck INT How lucky." in help_of(["train", "--policy", "guess"], capsys)
    assert main(["train", "--data", "x", "--out", "x", "--luck", "2"]) == 2
    assert "it is an option of guess" in capsys.readouterr().err
    assert run(["--tyro-print-completion", "bash"]) == 0
    assert "--luck" in capsys.readouterr().out


def test_a_shell_completes_every_command_and_option(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--tyro-print-completion", "bash"]) == 0
    said = capsys.readouterr().out
    for word in ("import-ravens", "hand-eye", "--radius-cm", "--backbone", "--statistics", "--rearranged"):
        assert word in said


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        ("inspect nowhere", 1),
        ("train --data nowhere --out run", 1),
        ("train --data nowhere --out run --new-looks 2", 2),
        ("train --data nowhere --out run --policy regression --backbone resnet18", 2),
        ("validate --policy nowhere --data nowhere --out out", 1),
        ("evaluate --policy nowhere --out out", 1),
        ("evaluate --policy oracle --task dance --out out", 2),
        ("collect --attempts 0 --out out", 2),
        ("report nowhere", 1),
    ],
)
def test_what_cannot_be_done_is_one_line_and_status_1_or_2_where_nobody_could_mean_it(
    arguments: str,
    status: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments.split()) == status
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = [line for line in captured.err.splitlines() if line.startswith("error:")]
    assert len(lines) == 1
    assert "Traceback" not in captured.err


def test_an_interruption_says_how_to_go_on_and_is_status_130(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stopped(_options: object) -> None:
        raise KeyboardInterrupt("go on with: baggie collect")

    monkeypatch.setattr("baggie.collect.collect", stopped)
    assert main(["collect", "--out", "anywhere"]) == 130
    assert capsys.readouterr().err == "go on with: baggie collect\n"


def test_json_is_one_object_on_stdout(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    from baggie.data import DatasetWriter

    with DatasetWriter(tmp_path / "data", task="t", robot_type="r", collection={}):
        pass
    assert main(["inspect", str(tmp_path / "data"), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["attempts"] == 0


def test_where_nothing_failed_it_says_none(capsys: pytest.CaptureFixture[str]) -> None:
    show({"succeeded": 12, "failed": {}, "doubtful": [], "labels": {"pick_within": {"rate": 1.0}}}, False)
    lines = ["succeeded: 12", "failed: none", "doubtful: none", "labels:", "  pick within: rate 1", ""]
    assert capsys.readouterr().out.split("\n") == lines
