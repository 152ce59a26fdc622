"""The one door: what is too large, too deep or not what it says is refused before it is read, by name."""

import io
import struct
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import from_json
from zebrat_bullet.errors import ConfigError, PolicyError
from zebrat_bullet.files import (
    is_file,
    parse_yaml,
    read_bytes,
    read_image,
    read_json,
    read_npz,
    read_safetensors,
    read_text,
    read_yaml,
    refusing,
)
from zebrat_bullet.training.learner_settings import DDPGConfig
from zebrat_bullet.training.settings import TrainConfig
from zebrat_bullet.training.sweep import Sweep


def write(folder: Path, data: bytes | str) -> Path:
    path = folder / "theirs.x"
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 1000, "more than 50 brackets"),
        ("a: &a [*a]", "names nothing that is complete"),
        ("d: 2020-99-01", "month must be in 1..12"),
        ("d: 2020-12-01", "is a date: write it in quotes"),
        ("b: !!binary aGk=", "is a bytes"),
        ("s: !!set {a}", "is a set"),
        ("1: 2", "the key '1' is no text"),
        ("n: " + "9" * 5000, "a number of 5000 digits"),
        ("n: " + "59:" * 900 + "1", "a number of 2701 digits"),
        ("x: !!python/object/apply:os.system [ls]", "could not determine a constructor"),
        ("a: [1", "theirs"),
    ],
)
def test_a_yaml_text_that_is_no_plain_data_is_refused(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        parse_yaml(text, "theirs", ConfigError)


@pytest.mark.parametrize("multiplied", ["[*a, *a, *a, *a, *a, *a, *a, *a]", "{<<: [*a, *a, *a, *a, *a, *a, *a, *a]}"])
def test_aliases_are_read_as_long_as_they_do_not_multiply(multiplied: str) -> None:
    assert parse_yaml("a: &a [1, 2]\nb: [*a, *a]", "theirs", ConfigError) == {"a": [1, 2], "b": [[1, 2], [1, 2]]}
    lines = ["k0: &a0 {x: 1}"]
    lines += [f"k{i + 1}: &a{i + 1} {multiplied.replace('*a', f'*a{i}')}" for i in range(8)]
    with pytest.raises(ConfigError, match="more than 200000 values, aliases written out"):
        parse_yaml("\n".join(lines), "theirs", ConfigError)


@pytest.mark.parametrize("text", ["[" * 100_000, "1" * 5000, "{", "", "[NaN"])
def test_a_json_file_that_is_none_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"theirs\.x: is not readable as JSON"):
        read_json(write(tmp_path, text), ConfigError)


def test_a_file_is_named_where_it_is_missing_too_large_endless_or_no_utf8(tmp_path: Path) -> None:
    path = write(tmp_path, "é".encode("latin-1"))
    for act, said in (
        (lambda: read_text(path, ConfigError), r"theirs\.x: is not UTF-8 text"),
        (lambda: read_bytes(path, ConfigError, 0), r"theirs\.x: holds 0 MB, more than 0 MB"),
        (lambda: read_bytes(Path("/dev/zero"), ConfigError), "/dev/zero: no such file"),
        (lambda: read_bytes(tmp_path, ConfigError), "no such file"),
        (lambda: read_yaml(Path("x" * 5000), ConfigError), r"x{80}\.\.\. \(5000 characters\): no such file"),
    ):
        with pytest.raises(ConfigError, match=said):
            act()
    assert not is_file("x" * 5000) and not is_file("a\x00b") and is_file(path)


def npz(**members: bytes) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return made.getvalue()


def npy(shape: str, kind: str = "<f8", content: bytes = bytes(8)) -> bytes:
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + content


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (npz(a=npy("(1000000000000,)")), r"claims to be \(1000000000000,\) of float64"),
        (npz(a=npy("(-1,)")), "claims to be"),
        (npz(a=npy("(1,)", "|O")), "an array of object; numbers and texts only"),
        (npz(a=npy("(" * 300)), "no whole zip archive"),
        (npz(a=bytes(20)), "no whole zip archive"),
        (npz(a=npy("(1000000,)", content=bytes(8_000_000)))[:-9], "no whole zip archive"),
        (npz(a=npy("(1000000,)", content=bytes(8_000_000))), "unpacks to 8 MB, more than 5 MB"),
    ],
)
def test_arrays_that_claim_too_much_are_refused_before_there_is_room_for_them(
    data: bytes, said: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=said):
        read_npz(write(tmp_path, data), ConfigError, 5_000_000)


def test_arrays_come_back_as_numpy_wrote_them(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    arrays = {"a": np.arange(6.0).reshape(2, 3).T, "b": np.array("text"), "c": np.zeros((0, 5)), "d": np.array(True)}
    np.savez_compressed(path, **arrays)
    read = read_npz(path, ConfigError)
    assert read.keys() == arrays.keys()
    assert all(np.array_equal(read[k], v) and read[k].dtype == v.dtype for k, v in arrays.items())


@pytest.mark.parametrize("header", [b"P5\n4 4\n0\n", b"P5\n9 9\n255\n"])
def test_an_image_is_refused_by_what_it_declares(header: bytes, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"theirs\.x: is no whole image"):
        read_image(write(tmp_path, header + bytes(16)), ConfigError)


@pytest.mark.parametrize("width", [9_000, 12_000, 20_000, 100_000])
def test_an_image_of_too_many_pixels_is_refused_by_their_number(width: int, tmp_path: Path) -> None:
    n_millions = width * 10_000 // 1_000_000
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        with pytest.raises(ConfigError, match=rf"\.x: has {n_millions} million pixels, more than 80 million: crop"):
            read_image(write(tmp_path, b"P5\n%d 10000\n255\n" % width + bytes(16)), ConfigError)


@pytest.mark.parametrize("data", [b"", bytes(8), b"\xff" * 20, struct.pack("<Q", 2) + b"{}" + bytes(3)])
def test_a_safetensors_file_that_is_none_is_refused(data: bytes, tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match=r"theirs\.x: is no whole safetensors file"):
        read_safetensors(write(tmp_path, data), PolicyError)


def test_a_parsers_own_exception_becomes_ours_and_ours_stays() -> None:
    with (
        pytest.raises(ConfigError, match="file: is no map \\(RecursionError\\); draw it"),
        refusing("file", ConfigError, "is no map", "draw it"),
    ):
        raise RecursionError
    with pytest.raises(PolicyError, match=r"^file is odd$"), refusing("file", ConfigError, "is no map", "draw it"):
        raise PolicyError("file is odd")
    with pytest.raises(ConfigError, match=r"file: is no map \(odd\)"), refusing("file", ConfigError, "is no map", "d"):
        raise PolicyError("odd")
    with pytest.raises(KeyboardInterrupt), refusing("file", ConfigError, "is no map", "draw it"):
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("kind", "settings", "said"),
    [
        (TrainConfig, '{"threads": 100000}', "threads must be 1 to 256, got 100000"),
        (TrainConfig, '{"n_envs": 1000000}', "n_envs must be 1 to 256"),
        (TrainConfig, '{"seed": -1}', "seed must be 0 to"),
        (TrainConfig, '{"episodes": 1000000000000}', "episodes must be 1 to"),
        (DDPGConfig, '{"hidden": [-5]}', "hidden must be 1 to 8192, got -5"),
        (DDPGConfig, '{"buffer_size": 1000000000000}', "buffer_size must be 1 to"),
        (TaskConfig, '{"physics": {"control_step_s": 1e300}}', "control_step_s must be 0.001 to 10"),
        (TaskConfig, '{"lidar": {"n_bearings": 1000000000}}', "n_bearings must be 8 to 36000"),
        (TaskConfig, '{"episode": {"max_steps": 1000000000}}', r"max_steps must be 1 to 1e\+06"),
        (TaskConfig, '{"reward": {"weights": {"F": 1e300}}}', "weights are at most 100 numbers"),
        (Sweep, f'{{"seeds": {list(range(20_000))}}}', "a sweep has at most 10000 runs, these axes make 20000"),
    ],
)
def test_numbers_are_bounded_where_they_are_declared(kind: type, settings: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        from_json(kind, settings)
