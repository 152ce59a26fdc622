"""ROS maps as others write them are read as map_server reads them, or refused with the field at fault."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from zebrat_bullet.errors import WorldError
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import World, load_world

SIZE = (80, 160)
"""Rows and columns: 4 m x 8 m of 5 cm, origin at the lower left corner."""
FIELDS = (
    "image: {image}\nresolution: 0.05\norigin: [0.0, 0.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
)
START = Pose2(2.0, 2.0, 0.0)
WALL = (5.0, 0.0, 5.2, 4.0)
Load = Callable[..., World]


def wall_cells() -> np.ndarray:
    """Return (80, 160) bool: a wall 0.2 m thick across, 5 m from the left."""
    cells = np.zeros(SIZE, dtype=bool)
    cells[:, 100:104] = True
    return cells


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """Returns what loads an image with fields of a map file, and of a world file where there are any."""

    def made(
        picture: Image.Image, more: str = "", keys: str = "", start: Pose2 | None = START, **changes: str
    ) -> World:
        picture.save(tmp_path / "map.png")
        text = FIELDS.format(image="map.png") + more
        for field, value in changes.items():
            text = "".join(f"{field}: {value}\n" if line.startswith(field) else line for line in text.splitlines(True))
        (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
        if not keys:
            return load_world(tmp_path / "map.yaml", start=start)
        (tmp_path / "own.yaml").write_text(f"name: own\nmap: map.yaml\n{keys}\n", encoding="utf-8")
        return load_world(tmp_path / "own.yaml", start=start)

    return made


def grey(wall: int, free: int, kind: type = np.uint8) -> Image.Image:
    return Image.fromarray(np.where(wall_cells(), wall, free).astype(kind))


def stacked(*channels: tuple[int, int]) -> Image.Image:
    """Return an image of these (wall, free) levels of its channels."""
    return Image.fromarray(np.stack([np.where(wall_cells(), *each) for each in channels], axis=-1).astype(np.uint8))


@pytest.mark.parametrize(
    ("image", "more"),
    [
        (grey(0, 254), ""),
        (grey(20 * 257, 65535, np.uint16), ""),  # 16 bits
        (stacked((0, 255), (0, 255), (0, 255)), ""),
        (stacked((0, 255), (0, 255), (0, 255), (255, 255)), ""),  # opaque: (0 + 0 + 0 + 255) / 4 is dark enough
        (stacked((0, 255), (0, 255), (0, 255), (0, 255)), ""),
        (stacked((0, 255), (255, 255)), ""),  # grey and alpha
        (grey(0, 254).convert("P"), ""),
        (grey(0, 254).convert("1"), ""),
        (grey(100, 0), "mode: raw\n"),
        (grey(0, 254), "mode: Scale\n"),
        (grey(254, 0), "mode: scale\n"),
    ],
)
def test_every_kind_of_image_has_its_walls_where_map_server_has_them(load: Load, image: Image.Image, more: str) -> None:
    negate = "1" if more == "mode: scale\n" else "0"
    world = load(image, more, negate=negate)
    assert world.walls.bounds == pytest.approx(WALL, abs=1e-3)
    assert world.walls.area == pytest.approx(0.8, rel=0.01)


@pytest.mark.parametrize("suffix", ["pgm", "png"])
def test_sixteen_bits_keep_their_walls(suffix: str, tmp_path: Path) -> None:
    deep = np.where(wall_cells(), 20 * 257, 65535).astype(">u2")
    if suffix == "pgm":
        (tmp_path / "map.pgm").write_bytes(b"P5 160 80 65535\n" + deep.tobytes())
    else:
        Image.fromarray(deep.astype(np.uint16)).save(tmp_path / "map.png")
    (tmp_path / "map.yaml").write_text(FIELDS.format(image=f"map.{suffix}"), encoding="utf-8")
    assert load_world(tmp_path / "map.yaml", start=START).walls.bounds == pytest.approx(WALL, abs=1e-3)


def test_see_through_pixels_are_unknown_in_mode_scale_and_averaged_in_mode_trinary(load: Load) -> None:
    half = stacked((0, 255), (0, 255), (0, 255), (128, 255))
    with pytest.raises(WorldError, match="no cell is darker"):
        load(half, "mode: scale\n")
    assert load(half).walls.area == pytest.approx(0.8, rel=0.01)  # 128 / 4 of 255 is dark


def test_a_map_without_a_free_cell_is_refused_with_the_shares_and_what_made_them(load: Load) -> None:
    clear = stacked((0, 0), (0, 0), (0, 0), (255, 0))  # black walls on nothing
    with pytest.raises(WorldError, match=r"no cell is free: 100\.0% .* 97\.5% of the pixels are see-through.* as dark"):
        load(clear)
    with pytest.raises(WorldError, match=r"2\.5% .* occupied, 97\.5% as unknown .*mode: scale\).* as unknown: save it"):
        load(clear, "mode: scale\n")
    with pytest.raises(WorldError, match=r"100\.0% .* as occupied.*negate: 1, .*mode: trinary\); change negate"):
        load(grey(254, 253), negate="1")
    grounds = grey(0, 205)
    with pytest.raises(WorldError, match=r"97\.5% as unknown .*or say `unknown: free` in a world file"):
        load(grounds)
    assert load(grounds, keys="unknown: free").walls.area == pytest.approx(0.8, rel=0.01)


def test_what_is_neither_free_nor_occupied_is_unknown_in_mode_scale_and_raw(load: Load) -> None:
    cells = np.where(wall_cells(), 0, 254).astype(np.uint8)
    cells[:, 140:] = 128
    assert load(Image.fromarray(cells), "mode: scale\n").unknown_ground.area == pytest.approx(4.0)
    raw = np.where(wall_cells(), 100, 0).astype(np.uint8)
    raw[:, 140:] = 255
    world = load(Image.fromarray(raw), "mode: raw\n")
    assert world.unknown_ground.area == pytest.approx(4.0) and world.walls.area == pytest.approx(0.8, rel=0.01)


def unknown_right() -> Image.Image:
    cells = np.where(wall_cells(), 0, 254).astype(np.uint8)
    cells[:, 120:] = 205
    return Image.fromarray(cells)


def test_unknown_cells_are_no_walls_but_no_place_to_begin_and_that_is_said(load: Load) -> None:
    with pytest.warns(UserWarning, match="25% of the cells are unknown"):
        assert load(unknown_right()).walls.area == pytest.approx(0.8, rel=0.01)
    with pytest.raises(WorldError, match=r"start: at \(7\.00, 2\.00\).*unknown ground.*would stand free at \("):
        load(unknown_right(), start=Pose2(7.0, 2.0, 0.0))


def test_unknown_cells_are_free_walls_or_refused_as_the_world_file_says(load: Load) -> None:
    assert load(unknown_right(), keys="unknown: free", start=Pose2(7.0, 2.0, 0.0)).walls.area == pytest.approx(
        0.8, rel=0.01
    )
    assert load(unknown_right(), keys="unknown: occupied").walls.area == pytest.approx(0.8 + 8.0, rel=0.01)
    with pytest.raises(WorldError, match=r"unknown: 25\.0% of the cells are unknown"):
        load(unknown_right(), keys="unknown: refused")
    assert load(grey(0, 254), keys="unknown: refused").walls.area == pytest.approx(0.8, rel=0.01)


def test_a_start_outside_of_the_image_is_refused_and_a_free_one_named_that_is_free(load: Load) -> None:
    with pytest.raises(WorldError, match=r"start: .*would stand free at \(") as caught:
        load(grey(0, 254), origin="[20.0, 0.0, 0.0]", start=None)
    words = str(caught.value).partition("--start ")[2].partition(";")[0].split()
    x, y, degrees = map(float, words)
    assert load(grey(0, 254), origin="[20.0, 0.0, 0.0]", start=Pose2(x, y, np.radians(degrees))).start.pose.x == x


@pytest.mark.parametrize("corridor", [np.s_[30:45, 10:60], np.s_[5:75, 100:115]])
def test_a_start_in_a_narrow_place_is_found_too(load: Load, corridor: tuple[slice, slice]) -> None:
    """A corridor of 0.75 m, along x or along y, and nothing else."""
    cells = np.zeros(SIZE, dtype=np.uint8)
    cells[corridor] = 254
    with pytest.raises(WorldError) as caught:
        load(Image.fromarray(cells), start=Pose2(1.0, 0.2, 0.3))
    x, y, degrees = map(float, str(caught.value).partition("--start ")[2].partition(";")[0].split())
    load(Image.fromarray(cells), start=Pose2(x, y, np.radians(degrees)))


def test_fields_of_other_tools_are_left_alone_and_named(load: Load) -> None:
    with pytest.warns(UserWarning, match="left alone: cost_translation_table, scale"):
        assert load(grey(0, 254), "scale: 2\ncost_translation_table: [1]\n").walls.area == pytest.approx(0.8, rel=0.01)


def test_image_paths_may_be_absolute_or_of_the_home_folder_or_of_a_folder_left_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    maps, home = tmp_path / "maps", tmp_path / "home"
    maps.mkdir(), home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    grey(0, 254).save(home / "far.pgm")
    for image in (home / "far.pgm", "~/far.pgm"):
        (maps / "map.yaml").write_text(FIELDS.format(image=image), encoding="utf-8")
        assert load_world(maps / "map.yaml", start=START).walls.bounds == pytest.approx(WALL, abs=1e-3)
    grey(0, 254).save(maps / "near.pgm")
    (maps / "map.yaml").write_text(FIELDS.format(image="/home/somebody/maps/near.pgm"), encoding="utf-8")
    with pytest.warns(UserWarning, match="beside the map is taken"):
        assert load_world(maps / "map.yaml", start=START).walls.bounds == pytest.approx(WALL, abs=1e-3)


def test_an_image_handed_over_directly_is_explained(tmp_path: Path) -> None:
    grey(0, 254).save(tmp_path / "map.pgm")
    with pytest.raises(WorldError, match=r"is an image.*write map\.yaml beside it.*resolution: 0\.05"):
        load_world(tmp_path / "map.pgm")
    (tmp_path / "map.yaml").write_text(FIELDS.format(image="map.pgm"), encoding="utf-8")
    with pytest.raises(WorldError, match=r"is an image.*name .*map\.yaml instead"):
        load_world(tmp_path / "map.pgm")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("origin", "[-nan, 0.0, 0.0]"),
        ("origin", "[.nan, 0.0, 0.0]"),
        ("origin", "[0.0, 0.0]"),
        ("origin", "[1.0e+300, 0.0, 0.0]"),
        ("resolution", ".inf"),
        ("resolution", "-0.05"),
        ("resolution", "[1]"),
        ("negate", "7"),
        ("occupied_thresh", "65"),
        ("image", "'a\\0b'"),
        ("image", "[]"),
        ("image", "."),
    ],
)
def test_nonsense_in_a_map_file_is_refused_with_file_and_field(load: Load, field: str, value: str) -> None:
    with pytest.raises(WorldError, match=rf"map\.yaml: {field}"):
        load(grey(0, 254), **{field: value})


@pytest.mark.parametrize(
    "data",
    [
        b"P5 160 80 255\n" + bytes(100),
        b"P5 160 80 0\n" + bytes(160 * 80),
        b"P5 100000 100000 255\n" + bytes(100),
        b"P5 20000 10000 255\n" + bytes(100),
        b"P5",
        b"",
        b"\x89PNG\r\n\x1a\n" + bytes(40),
    ],
)
def test_a_damaged_or_endless_image_is_refused_at_once(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "map.pgm").write_bytes(data)
    (tmp_path / "map.yaml").write_text(FIELDS.format(image="map.pgm"), encoding="utf-8")
    begin = time.process_time()
    with pytest.raises(WorldError, match=r"map\.pgm"):
        load_world(tmp_path / "map.yaml")
    assert time.process_time() - begin < 2.0


def test_a_speckled_map_is_refused_at_once_and_one_of_many_specks_is_read(load: Load) -> None:
    rng = np.random.default_rng(0)
    begin = time.process_time()
    with pytest.raises(WorldError, match=r"have \d+ corners.*remove specks"):
        load(Image.fromarray(np.where(rng.random((1000, 1000)) < 0.2, 0, 254).astype(np.uint8)))
    assert time.process_time() - begin < 5.0
    cells = np.where(rng.random((300, 300)) < 0.01, 0, 254).astype(np.uint8)
    cells[150:250, 20:100] = 254
    assert load(Image.fromarray(cells), start=Pose2(3.0, 5.0, 0.0)).walls.area == pytest.approx(
        (cells == 0).sum() * 0.05**2, rel=0.06
    )


@pytest.mark.parametrize("short_m", [0.0, 0.05], ids=["from wall to wall", "short of the walls"])
def test_an_open_line_beside_a_centre_line_may_end_short_of_walls_of_cells(load: Load, short_m: float) -> None:
    cells = np.zeros(SIZE, dtype=bool)
    cells[28:32, 10:100] = cells[52:56, 10:100] = cells[28:56, 10:14] = True  # rows go downwards from y = 4 m
    keys = f"unknown: free\nopen_line: [[4.8, {1.4 + short_m}], [4.8, {2.4 - short_m}]]\n"
    keys += "centre_line: [[1.0, 1.9], [7.0, 1.9]]\nstart: {pose: [1.5, 1.9, 0]}\n"
    world = load(Image.fromarray(np.where(cells, 0, 254).astype(np.uint8)), keys=keys, start=None)
    assert world.free_space.bounds == pytest.approx((0.7, 1.4, 4.8, 2.4), abs=0.01)
