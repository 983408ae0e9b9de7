"""What lies among our files without being ours is passed over and named, and stays as it is."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from baggie.cli.main import main
from baggie.data import DatasetWriter, inspect_dataset, open_dataset
from baggie.errors import BaggieWarning, DataError
from baggie.pictures import read_pictures, write_picture
from baggie.ravens.format import RavensFolder, write_episode
from baggie.report.report import gather
from helpers.ravens_folder import FIELDS, NAME, make_episode
from helpers.synthetic import TASK, make_attempt

SIZE = (64, 36)
ATTEMPT = "attempts/chunk-000/attempt-000000.parquet"
EPISODE = "meta/episodes/chunk-000/file-000.parquet"
FRAMES = "data/chunk-000/file-000.parquet"


def record(root: Path, *ids: int) -> None:
    with DatasetWriter(root, task=TASK, robot_type="drawn", picture_size=SIZE) as writer:
        for i in ids:
            writer.append(make_attempt(i, np.random.default_rng(i), SIZE))


def litter(path: Path, *, valid: bool) -> dict[Path, bytes]:
    """What other programs leave beside a file: copies of it, or bytes of their own; what is where."""
    content = path.read_bytes() if valid else b"\0\5\26\7\0\2\0\0Mac OS X"
    left = [
        path.with_name(name)
        for name in (
            f"{path.stem} (1){path.suffix}",
            f"{path.stem} (conflicted copy){path.suffix}",
            f"{path.stem} - Kopie{path.suffix}",
            f"._{path.name}",
            f"{path.name}~",
            f"{path.name}.tmp",
            f".{path.name}.icloud",
            ".DS_Store",
            "Thumbs.db",
        )
    ]
    left.append(path.parent.with_name(f"{path.parent.name} (1)") / path.name)
    left[-1].parent.mkdir(exist_ok=True)
    for each in left:
        each.write_bytes(content)
    return dict.fromkeys(left, content)


@pytest.mark.parametrize("valid", [True, False])
@pytest.mark.parametrize("beside", [ATTEMPT, EPISODE, FRAMES])
def test_a_recording_reads_and_goes_on(tmp_path: Path, beside: str, valid: bool) -> None:
    record(tmp_path, 0, 1)
    left = litter(tmp_path / beside, valid=valid)
    with pytest.warns(BaggieWarning, match=rf"passed over in .*{Path(beside).parent}.* and 9 more"):
        record(tmp_path, 2)
    assert {path: path.read_bytes() for path in left} == left
    for path in left:
        path.unlink()
    assert open_dataset(tmp_path).attempt_ids.tolist() == [0, 1, 2]
    assert [attempt.seed for attempt in open_dataset(tmp_path)] == [0, 1, 2]
    frames = json.loads((tmp_path / "meta/info.json").read_text())["total_frames"]
    assert frames == len(list(tmp_path.glob("data/*/*.parquet"))) == 3


@pytest.mark.parametrize("valid", [True, False])
@pytest.mark.parametrize("read", [lambda root: list(open_dataset(root)), inspect_dataset])
def test_a_recording_with_copies_beside_its_records_is_read(
    tmp_path: Path, read: Callable[[Path], object], valid: bool
) -> None:
    record(tmp_path, 0, 1)
    litter(tmp_path / ATTEMPT, valid=valid)
    with pytest.warns(BaggieWarning) as warned:
        read(tmp_path)
    assert len({str(warning.message) for warning in warned}) == 1


def test_a_record_in_the_place_of_another_number_is_none_of_ours(tmp_path: Path) -> None:
    record(tmp_path, 0, 1)
    (tmp_path / ATTEMPT).rename(tmp_path / "attempts/chunk-000/attempt-0.parquet")
    with pytest.warns(BaggieWarning, match="attempt-0.parquet"), pytest.raises(DataError, match="record"):
        open_dataset(tmp_path)


def test_unfinished_files_of_others_stay_where_ours_are_finished(tmp_path: Path) -> None:
    record(tmp_path, 0)
    partial = tmp_path / ".baggie/partial"
    ours, theirs = partial / "0-attempt-000001.parquet", partial / "._0-attempt-000001.parquet"
    for path in (ours, theirs):
        path.write_bytes(b"half")
    record(tmp_path, 1)
    assert theirs.exists()
    assert not ours.exists()


def test_a_ravens_folder_is_read(tmp_path: Path) -> None:
    write_episode(tmp_path, make_episode())
    for field in FIELDS:
        litter(tmp_path / field / NAME, valid=False)
    with pytest.warns(BaggieWarning, match="and 44 more") as warned:
        folder = RavensFolder(tmp_path)
    assert len(warned) == 1
    assert folder.episode_ids == ((3, 9007),)


def test_a_folder_of_pictures_is_read(tmp_path: Path) -> None:
    write_picture(tmp_path / "000.png", np.zeros((4, 6, 3), np.uint8))
    for name in ("._000.png", ".hidden.jpg"):
        (tmp_path / name).write_bytes(b"Mac OS X")
    with pytest.warns(BaggieWarning, match=r"\._000\.png and 1 more"):
        assert [name for name, _ in read_pictures(tmp_path)] == ["000.png"]


def test_a_copied_log_of_a_training_shows_no_step_twice(tmp_path: Path) -> None:
    from torch.utils.tensorboard import SummaryWriter

    run = tmp_path / "run"
    for begins, shift in ((0, 0), (3, 100)):  # the second goes on from a save at 3
        with SummaryWriter(str(run), purge_step=begins) as board:
            for step in range(begins, begins + 5):
                board.add_scalar("train/loss", shift + step, step)
        (log,) = (each for each in run.glob("events*") if ".tfevents.00" not in each.name)
        began = log.name.split(".tfevents.")[1].split(".")[0]
        log.rename(run / log.name.replace(began, f"00{begins}"))  # seconds apart, as two trainings are
    (run / "config.yaml").write_text("policy: keypoint\n")
    (run / "metrics.json").write_text("{}")
    for events in list(run.glob("events*")):
        litter(events, valid=True)
    with pytest.warns(BaggieWarning, match="tfevents"):
        steps, values = gather([run]).trainings[0].scalars["train/loss"]
    assert steps.tolist() == list(range(8))
    assert values.tolist() == [0, 1, 2, 103, 104, 105, 106, 107]


def test_looking_at_a_recording_that_cannot_be_written_to_shows_the_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder stands where the picture would: nobody can write it, root neither."""
    record(tmp_path / "data", 0, 1)
    litter(tmp_path / "data" / ATTEMPT, valid=True)
    (tmp_path / "data/contact-sheet.png").mkdir()
    before = sorted(tmp_path.rglob("*"))
    command = [sys.executable, "-m", "baggie", "inspect", str(tmp_path / "data"), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["attempts"] == 2
    assert "contact_sheet" not in json.loads(done.stdout)
    warnings = [line for line in done.stderr.splitlines() if line]
    assert all(line.startswith("warning: ") for line in warnings)
    assert ["passed over" in warnings[0], "cannot be written" in warnings[1]] == [True, True]
    assert len(warnings) == 2
    asked = tmp_path / "data" / FRAMES / "below-a-file.png"
    with pytest.warns(BaggieWarning):
        assert main(["inspect", str(tmp_path / "data"), "--sheet", str(asked)]) == 1
    captured = capsys.readouterr()
    assert "attempts: 2" in captured.out
    assert captured.err.startswith(f"error: {asked} cannot be written")
    assert sorted(tmp_path.rglob("*")) == before
