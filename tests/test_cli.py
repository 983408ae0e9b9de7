import json
from pathlib import Path

import pytest

from baggie.cli.main import VERBS, main
from baggie.cli.output import show


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_with_an_example(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main([verb, "--help"])
    assert stopped.value.code == 0
    assert f"Example: baggie {verb}" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("arguments", [[], ["dance"], ["collect"], ["train", "--policy", "magic"]])
def test_wrong_usage_is_status_2(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2


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

    monkeypatch.setattr("baggie.cli.main.run_collect", stopped)
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
