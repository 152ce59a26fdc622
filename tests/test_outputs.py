"""Files are written whole or not at all, nothing else in their folder is touched, and a place is tried before work."""

import re

import imageio_ffmpeg
import numpy as np
import pytest
from recorded import episode, world

from zebrat_bullet.cli.main import main
from zebrat_bullet.errors import RenderError
from zebrat_bullet.evaluation.csv_log import CsvLog
from zebrat_bullet.evaluation.npz import save_npz
from zebrat_bullet.evaluation.records import save_record
from zebrat_bullet.files import write_safetensors
from zebrat_bullet.outputs import require_writable, written_whole
from zebrat_bullet.recording.write import write_recording
from zebrat_bullet.report.mp4 import write_mp4

PICTURES = np.random.default_rng(0).integers(0, 256, (200, 36, 64, 3), np.uint8)


def cut_log(path):
    log = CsvLog(path, ("episode",))
    log.append({"episode": 1})
    log.cut_after(0)


WRITERS = {
    "x.npz": lambda path: save_npz(path, "test/1", {"n": np.zeros(3)}),
    "x.csv": cut_log,
    "x.safetensors": lambda path: write_safetensors(path, {"n": np.zeros(3)}),
    "x.mcap": lambda path: write_recording(episode(), world(), path),
    "x.mp4": lambda path: write_mp4(path, PICTURES[:3], 25, (64, 36)),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_of_the_users_that_is_called_like_an_unfinished_one_is_kept(name, tmp_path):
    theirs = [tmp_path / each for each in ("x.part", f"{name}.part", ".x.part", ".x.part.mp4")]
    for path in theirs:
        path.write_text("mine", encoding="utf-8")
    WRITERS[name](tmp_path / name)
    assert all(path.read_text(encoding="utf-8") == "mine" for path in theirs)
    assert {path.name for path in tmp_path.iterdir()} == {name, *(path.name for path in theirs)}


def test_what_fails_leaves_the_folder_as_it_was_and_what_a_kill_has_left_goes(tmp_path):
    path = tmp_path / "new" / "x.txt"
    with pytest.raises(ZeroDivisionError), written_whole(path) as part:
        part.write_text("half", encoding="utf-8")
        raise ZeroDivisionError
    assert not list(path.parent.iterdir())
    part.write_text("what a kill has left of it, longer than", encoding="utf-8")
    with written_whole(path) as part:
        part.write_text("whole", encoding="utf-8")
    assert path.read_text(encoding="utf-8") == "whole" and [each.name for each in path.parent.iterdir()] == ["x.txt"]
    with written_whole(tmp_path / ("x" * 255)) as part:  # the longest that there is
        part.write_text("whole", encoding="utf-8")


def test_to_try_a_place_leaves_nothing_there(tmp_path):
    (tmp_path / "there").mkdir()
    for path, folder in (("a/b/x.mp4", False), ("a/b", True), ("there/x.mp4", False), ("there", True)):
        require_writable(tmp_path / path, folder=folder)
    assert [path.name for path in tmp_path.rglob("*")] == ["there"]


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "folder.mp4").mkdir()
    (tmp_path / "file").touch()
    for path, folder, kind in (
        (tmp_path / "folder.mp4", False, IsADirectoryError),
        (tmp_path / "file", True, FileExistsError),
        (tmp_path / "file" / "x.mp4", False, FileExistsError),
        ("/proc/x.mp4", False, FileNotFoundError),
        ("/proc", True, FileNotFoundError),
    ):
        with pytest.raises(kind) as refused:
            require_writable(type(tmp_path)(path), folder=folder)
        assert str(path).startswith(refused.value.filename)


@pytest.fixture
def nobody_drives(monkeypatch):
    def drive(*arguments):
        raise AssertionError("the place was not tried before the drive")

    monkeypatch.setattr("zebrat_bullet.task.drive.Drive.reset", drive)
    for name in (
        *("teleop.session.TeleopServer", "evaluation.judge.judge", "evaluation.held_out.judge_set"),
        *("evaluation.generated.judge_generated", "imitation.planar_demonstrations.drive_seeds"),
    ):
        monkeypatch.setattr(f"zebrat_bullet.{name}", drive)


@pytest.mark.usefixtures("nobody_drives")
@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["video", "--world", "track_2", "--out", "/proc/x.mp4"], "cannot be written: No such file or directory: /pro"),
        (["video", "--world", "track_2", "--out", "folder.mp4"], "cannot be written: Is a directory: folder.mp4"),
        (["replay", "record.npz", "--out", "folder.mp4"], "cannot be written: Is a directory: folder.mp4"),
        (["replay", "record.npz", "--out", "again.avi"], "a video's name ends in .mp4, got 'again.avi'"),
        (["record", "record.npz", "--out", "/proc/x.mcap"], "cannot be written: No such file or directory: /proc"),
        (["record", "--world", "track_2", "--out", "/proc/x.mcap"], "cannot be written: No such file or directory: "),
        (["record", "--world", "track_2"], "cannot be written: File exists: results"),
        (["teleop", "--world", "track_2", "--out", "/proc"], "cannot be written: No such file or directory: /proc"),
        (["evaluate", "--agent", "random", "--worlds", "real_1", "--out", "/proc"], "cannot be written: No such file"),
        (
            ["evaluate", "--agent", "random", "il", "--worlds", "real_1", "--out", "record.npz"],
            "cannot be written: Fil",
        ),
        (["evaluate", "--agent", "il", "--set", "corners", "--out", "/proc"], "cannot be written: No such file"),
        (["evaluate", "--agent", "il", "--generated", "2"], "cannot be written: Not a directory: results/gen"),
        (["demonstrate", "--agent", "random", "--worlds", "real_1"], "cannot be written: Not a directory: results/dem"),
        (
            ["demonstrate", "--agent", "oracle", "--generated", "1", "--out", "/proc/x"],
            "cannot be written: No such file",
        ),
    ],
)
def test_a_drive_that_could_not_be_written_is_not_begun(command, said, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    save_record(episode().record, tmp_path / "record.npz")
    (tmp_path / "folder.mp4").mkdir()
    (tmp_path / "results").touch()
    assert main([*command, "--quiet"]) == 2
    assert said in capfd.readouterr().err


@pytest.mark.parametrize("when", ["at once", "at the end"])
def test_an_encoder_that_dies_is_told_with_its_own_words_and_leaves_nothing(when, tmp_path, monkeypatch):
    dies = tmp_path / "ffmpeg"
    reads = "" if when == "at once" else "cat > /dev/null; "
    dies.write_text(f"#!/bin/sh\n{reads}echo 'No space left on device' >&2; exit 1\n", encoding="utf-8")
    dies.chmod(0o755)
    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", lambda: str(dies))
    path = tmp_path / "videos" / "x.mp4"
    with pytest.raises(RenderError, match=re.escape(f"{path}: the encoder could not write it (No space left on dev")):
        write_mp4(path, PICTURES, 25, (64, 36))
    assert not list(path.parent.iterdir())
