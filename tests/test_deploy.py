"""An exported policy drives where nothing but numpy and ONNX Runtime is, and stops rather than guess."""

import hashlib
import json
import math
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import onnx
import pytest
from exported import change, random_policy, way
from onnx import TensorProto, helper, numpy_helper

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.export import export_policy
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.deploy import Decision, Driver, Limits
from zebrat_bullet.errors import ConfigError, PolicyError
from zebrat_bullet.geometry import rotation_from_rpy
from zebrat_bullet.robot import load_robot
from zebrat_bullet.sensing.safety_region import SafetyRegion, make_region
from zebrat_bullet.types import Command, Reading

REGION: SafetyRegion = make_region(load_robot("zebrat"), TaskConfig().region, 360)
FREE = np.full(360, 2.0, np.float32)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("exported")
    export_policy("shipped", made)
    return made


@pytest.fixture
def driver(folder: Path) -> Driver:
    return Driver.load(folder)


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    """Return a copy of the export, to be spoilt."""
    return Path(shutil.copytree(folder, tmp_path / "copy"))


@cache
def a_cloud() -> np.ndarray:
    """Return a recorded cloud as a real lidar sends it: rays without a return are infinite."""
    cloud = way().clouds[10]
    return np.where(cloud.valid[:, None], cloud.points_lidar, np.float32(np.inf))


def both(driver: Driver, decision: Decision) -> Command:
    """Return what was commanded, which must not be a stop."""
    assert not decision.refusal, decision.refusal
    assert driver.last_command == decision.command
    return decision.command


def refusal(driver: Driver, decide: Callable[[], Decision]) -> str:
    """Return why a driver that steers refuses, which must be a stop that holds the steering."""
    driver.last_command = Command(0.5, 0.25)
    decision = decide()
    assert decision.command == Command(0.0, 0.25) == driver.last_command and decision.refusal
    return decision.refusal


# What is driven.


def test_a_cloud_is_driven_as_the_agent_drives_its_scan(driver):
    agent = load_agent("shipped", TaskConfig())
    last = Command(0.0, 0.0)
    for scan, cloud in zip(way().scans, way().clouds, strict=True):
        expected = agent.act(Reading(scan, REGION.measure(scan), last, 0.0, 0.0))
        driver.last_command = last
        given = both(driver, driver.drive_cloud(cloud.points_lidar))
        assert (given.speed_mps, given.steering_rad) == pytest.approx(
            (expected.speed_mps, expected.steering_rad), abs=1e-5
        )
        assert driver.last_scan.ranges_m == pytest.approx(scan.ranges_m, abs=1e-4)
        last = expected


def test_a_lidar_that_the_car_tilts_sees_the_walls_where_they_are(driver):
    level = both(driver, driver.drive_cloud(a_cloud()))
    seen = driver.last_scan.ranges_m
    tilt = rotation_from_rpy(0.04, -0.03, 0.0)
    turned = np.where(np.isfinite(a_cloud()), a_cloud(), np.nan) @ tilt  # as the tilted lidar says them
    driver.reset()
    tilted = both(driver, driver.drive_cloud(turned, rotation_level=tilt))
    assert np.abs(driver.last_scan.ranges_m - seen).max() < 1e-4
    assert tilted.steering_rad == pytest.approx(level.steering_rad, abs=1e-3)
    driver.drive_cloud(turned)
    assert np.abs(driver.last_scan.ranges_m - seen).max() > 0.5  # not told of it, it sees the floor


def test_a_lower_lidar_is_told_by_its_height(driver):
    wall = np.array([[2.0, y, z] for y in np.linspace(-1.0, 1.0, 51) for z in (-0.1, 0.0, 0.2)], np.float32)
    above = [[2.0 * math.cos(a), 2.0 * math.sin(a), 4.0] for a in np.linspace(0.1, 6.2, 16)]
    wall = np.concatenate([wall, np.array(above, np.float32)])
    driver.drive_cloud(wall, height_m=0.3)
    assert driver.last_scan.ranges_m[180] == pytest.approx(2.0, abs=1e-3)
    driver.drive_cloud(wall, height_m=1.5)  # now all of it is above the band
    assert (driver.last_scan.ranges_m == 6.0).all()


def test_a_lidar_mounted_upside_down_is_turned_as_the_definition_says(copy):
    change(copy / "policy.json", "scan", "lidar_rotation_base", to=[[1, 0, 0], [0, -1, 0], [0, 0, -1]])
    upside_down, upright = Driver.load(copy), Driver.load(copy)
    upside_down.drive_cloud(a_cloud() * np.array([1, -1, -1], np.float32))
    upright.drive_cloud(a_cloud(), rotation_level=np.eye(3))
    assert (upside_down.last_scan.ranges_m == upright.last_scan.ranges_m).all()


def test_lost_points_are_no_returns_whether_nan_infinite_the_origin_or_beyond_reach(driver):
    kept = a_cloud()[np.isfinite(a_cloud()).all(axis=1)]
    expected = both(driver, driver.drive_cloud(kept))
    for lost in (math.nan, math.inf, -math.inf, 0.0, 50.0):
        driver.reset()
        more = np.concatenate([kept, np.full((500, 3), lost, np.float32)])
        given = both(driver, driver.drive_cloud(more.astype(np.float64)))
        off = given.speed_mps - expected.speed_mps, given.steering_rad - expected.steering_rad
        assert max(map(abs, off)) < 1e-5


def test_a_scan_of_more_rays_from_elsewhere_gives_each_bearing_its_nearest_return(driver):
    angles = -1.0 + np.arange(1440) * math.radians(0.25)
    ranges = np.where(np.abs(np.sin(angles - 0.3)) < 0.03, 1.0, 3.0)  # something thin ahead to the left, and behind
    both(driver, driver.drive_scan(ranges, -1.0, math.radians(0.25)))
    seen = driver.last_scan.ranges_m
    at = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    near = np.abs(np.sin(at - 0.3)) < 0.03
    assert (seen[near] == 1.0).all() and (seen[np.abs(np.sin(at - 0.3)) > 0.04] == 3.0).all()


def test_a_scan_clockwise_or_with_half_a_step_between_is_the_same_scan(driver):
    ranges = np.linspace(1.0, 3.0, 360).astype(np.float32)
    driver.drive_scan(ranges)
    assert (driver.last_scan.ranges_m == ranges).all()
    step = 2.0 * math.pi / 360
    driver.drive_scan(ranges[::-1].copy(), -math.pi + 359 * step, -step)
    assert (driver.last_scan.ranges_m == ranges).all()
    driver.drive_scan(ranges, -math.pi + step / 2.0, step)
    assert (driver.last_scan.ranges_m == np.minimum(ranges, np.roll(ranges, 1))).all()


def test_a_lost_ray_reads_as_the_nearer_of_its_neighbours_and_a_free_one_as_the_reach(driver):
    ranges = FREE.copy()
    ranges[[0, 90, 180]], ranges[[89, 91]] = (math.inf, math.nan, 0.0), (1.5, 1.2)
    both(driver, driver.drive_scan(ranges))
    assert driver.last_scan.ranges_m[[0, 90, 180]].tolist() == [6.0, np.float32(1.2), 2.0]


def test_a_reset_forgets_the_last_command(driver):
    first = both(driver, driver.drive_cloud(a_cloud()))
    assert both(driver, driver.drive_cloud(a_cloud())) != first
    driver.reset()
    assert driver.last_scan is None and both(driver, driver.drive_cloud(a_cloud())) == first


# What is refused.

STOPS: dict[str, tuple[Callable[[Driver], Decision], str]] = {
    "cloud of pairs": (lambda d: d.drive_cloud(np.zeros((5760, 2), np.float32)), r"shape \(N, 3\), got \(5760, 2\)"),
    "flat cloud": (lambda d: d.drive_cloud(np.zeros(17280, np.float32)), r"shape \(N, 3\), .* got \(17280,\)"),
    "list": (lambda d: d.drive_cloud([[1.0, 0.0, 0.0]] * 500), "NumPy array of float32 or float64, got list"),
    "whole numbers": (lambda d: d.drive_cloud(np.ones((500, 3), int)), "float32 or float64, got int64"),
    "texts": (lambda d: d.drive_scan(np.array(["2.0"] * 360)), "float32 or float64, got <U3"),
    "all nan": (lambda d: d.drive_cloud(np.full((5760, 3), np.nan, np.float32)), "0 of 5760 points are returns"),
    "all free": (lambda d: d.drive_cloud(np.full((5760, 3), np.inf, np.float32)), "0 of 5760 points are returns"),
    "nothing": (lambda d: d.drive_cloud(np.zeros((0, 3), np.float32)), "0 of 0 points .* at least 100 are needed"),
    "half a turn": (lambda d: d.drive_cloud(a_cloud()[a_cloud()[:, 0] < 0.0]), "eighth of the turn .* holds 0 returns"),
    "mirror image": (
        lambda d: d.drive_cloud(a_cloud(), rotation_level=np.diag([1.0, 1.0, -1.0])),
        "must be a .3, 3. rotation matrix",
    ),
    "age of None": (lambda d: d.drive_cloud(a_cloud(), age_s=None), "age is a number of seconds, got None"),
    "few points": (lambda d: d.drive_cloud(np.ones((99, 3), np.float32)), "99 of 99 points"),
    "stale cloud": (lambda d: d.drive_cloud(a_cloud(), age_s=0.31), r"0.310 s old, at most 0.300 s"),
    "stale scan": (lambda d: d.drive_scan(FREE, age_s=0.31), "look whether the lidar is alive"),
    "from the future": (
        lambda d: d.drive_cloud(a_cloud(), age_s=-0.03),
        "from 0.030 s in the future: the lidar's clock",
    ),
    "no age": (lambda d: d.drive_cloud(a_cloud(), age_s=math.nan), "the scan is nan s old"),
    "no rotation": (lambda d: d.drive_cloud(a_cloud(), rotation_level=2.0 * np.eye(3)), "rotation matrix"),
    "nan rotation": (lambda d: d.drive_cloud(a_cloud(), rotation_level=np.full((3, 3), np.nan)), "rotation matrix"),
    "no height": (
        lambda d: d.drive_cloud(a_cloud(), height_m=math.nan),
        "height above the floor is 0 to 10 m, got nan",
    ),
    "a height in cm": (lambda d: d.drive_cloud(a_cloud(), height_m=75.0), "height above the floor is 0 to 10 m"),
    "a height of words": (lambda d: d.drive_cloud(a_cloud(), height_m="low"), "height above the floor is 0 to 10 m"),
    "table of scans": (lambda d: d.drive_scan(np.ones((2, 360), np.float32)), r"shape \(n,\), .* got \(2, 360\)"),
    "no rays": (lambda d: d.drive_scan(np.zeros(0, np.float32)), "a ray every 360 degrees"),
    "nan rays": (lambda d: d.drive_scan(np.full(360, np.nan, np.float32)), "0 of 360 rays have a return"),
    "free rays": (lambda d: d.drive_scan(np.full(360, np.inf, np.float32)), "at least 5% are needed"),
    "lost where needed": (
        lambda d: d.drive_scan(np.where(abs(np.arange(360) - 180) < 3, np.nan, FREE)),
        "1 of the 32 b",
    ),
    "too near": (lambda d: d.drive_scan(np.where(np.arange(360) == 7, -np.inf, FREE)), "too near to be measured"),
    "coarse": (lambda d: d.drive_scan(FREE[::2].copy()), "every 2 degrees, the policy needs one every 1"),
    "half around": (
        lambda d: d.drive_scan(np.full(541, 2.0, np.float32), -2.356, math.radians(0.5)),
        r"from -135.0 to 135.0 degrees, leaves out \d+ of the 32 bearings",
    ),
    "no increment": (lambda d: d.drive_scan(FREE, -math.pi, 0.0), "steps other than 0, both in radians"),
    "nan angle": (
        lambda d: d.drive_scan(FREE, math.nan, 0.01),
        "begins at a bearing of -2 pi to 2 pi .* angle_min nan",
    ),
    "an angle in degrees": (lambda d: d.drive_scan(FREE, -90.0), "both in radians, got angle_min -90.0"),
    "an angle that is none": (lambda d: d.drive_scan(FREE, None), "both in radians, got angle_min None"),
    "a step of words": (lambda d: d.drive_scan(FREE, 0.0, "1"), "angle_increment '1'"),
    "time that runs back": (lambda d: d.drive_cloud(a_cloud(), since_s=-0.1), "since the last call .* got -0.1"),
    "no time": (lambda d: d.drive_scan(FREE, since_s=math.nan), "since the last call .* got nan"),
    "masked, all of it": (lambda d: d.drive_cloud(np.ma.masked_all((5760, 3), np.float32)), "0 of 5760 points"),
}


@pytest.mark.parametrize("case", STOPS)
def test_what_cannot_be_relied_on_is_a_stop_that_says_why(driver, case):
    decide, said = STOPS[case]
    assert re.search(said, told := refusal(driver, lambda: decide(driver))), told
    assert driver.drive_cloud(a_cloud()).refusal == ""  # and the next good one is driven


def test_the_documented_refusals_are_those_that_are_given(driver):
    page = (Path(__file__).parent.parent / "docs/deploy.md").read_text(encoding="utf-8")
    said = re.findall(r"^\| .* \| `(.*)` \|$", page.partition("## When it stops")[2].partition("\n\n`Driver")[0], re.M)
    given = [decide(driver).refusal for decide, _ in STOPS.values()]
    assert len(said) == 11
    for text in said:
        begins = text.removesuffix("...").removesuffix(" ").removesuffix(";")
        assert any(refusal.startswith(begins) for refusal in given), text


def test_a_network_that_gives_no_number_is_a_stop(driver):
    driver._network = lambda observations: np.full((1, 2), np.nan, np.float32)
    assert "not two finite numbers" in refusal(driver, lambda: driver.drive_scan(FREE))


def test_limits_can_be_set_and_are_checked(folder):
    strict = Driver.load(folder, limits=Limits(stale_s=0.05, least_points=3000))
    assert "at most 0.050 s" in strict.drive_cloud(a_cloud(), age_s=0.06).refusal
    assert "at least 3000 are needed" in strict.drive_cloud(a_cloud()[:2000]).refusal
    for wrong in ({"stale_s": -1.0}, {"stale_s": math.nan}, {"least_points": 0}, {"least_share": 2.0}):
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            Limits(**wrong)


def test_a_policy_refuses_another_car(folder, driver):
    assert Driver.load(folder, car=driver.car)
    corners = driver.car.outline_base
    assert Driver.load(folder, car=replace(driver.car, name="other", outline_base=corners[1:] + corners[:1]))
    longer = replace(driver.car, outline_base=((-0.5, -0.3), (0.6, -0.3), (0.6, 0.3), (-0.5, 0.3)))
    with pytest.raises(PolicyError, match="was trained for another car: outline_base"):
        Driver.load(folder, car=longer)
    with pytest.raises(PolicyError, match=r"wheelbase_m 0.6 instead of 0.56; max_speed_mps 1.0 instead of 0.6"):
        Driver.load(folder, car=replace(driver.car, wheelbase_m=0.6, max_speed_mps=1.0))
    with pytest.raises(PolicyError, match="outline_base"):
        Driver.load(folder, car=replace(driver.car, outline_base=corners[:3]))
    turned = ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
    with pytest.raises(PolicyError, match="lidar_rotation_base"):
        Driver.load(folder, car=replace(driver.car, lidar_rotation_base=turned))
    with pytest.raises(ConfigError, match="is no rotation"):
        replace(driver.car, lidar_rotation_base=((1.0, 0.0), (0.0, 1.0)))
    # How it brakes the policy does not know: the supervisor is told of the real car.
    assert Driver.load(folder, car=replace(driver.car, deceleration_mps2=0.5)).car.deceleration_mps2 == 0.5


def test_a_scan_from_end_to_end_and_numbers_of_numpy_are_taken(driver):
    """Of 360 rays from -pi to pi, both named, each stands 1.003 degrees from the next."""
    both(driver, driver.drive_scan(FREE, -math.pi, 2.0 * math.pi / 359))
    commands = []
    for cloud, age_s in (
        (a_cloud(), np.float32(0.05)),
        (a_cloud(), np.int64(0)),
        (np.ma.masked_invalid(a_cloud()), 0.0),
    ):
        driver.reset()
        commands.append(both(driver, driver.drive_cloud(cloud, age_s)))
    assert commands[0] == commands[1] == commands[2]


# Files of others.


def model_file(folder: Path, model: onnx.ModelProto) -> None:
    """Put another model into an export, its hash too."""
    data = model.SerializeToString()
    (folder / "policy.onnx").write_bytes(data)
    change(folder / "policy.json", "model", "sha256", to=hashlib.sha256(data).hexdigest())


@pytest.mark.parametrize("name", ["policy.json", "policy.onnx"])
def test_a_missing_cut_or_foreign_file_is_named(copy, name):
    whole = (copy / name).read_bytes()
    for spoilt in (None, b"", whole[: len(whole) // 2], b"\x80\x04K\x01.", b"\xff" * 1000, whole + b"\n\x00"):
        (copy / name).unlink() if spoilt is None else (copy / name).write_bytes(spoilt)
        with pytest.raises(PolicyError, match=name):
            Driver.load(copy)
        (copy / name).touch()


def test_a_single_bit_of_the_network_is_not_changed_unnoticed(copy):
    data = bytearray((copy / "policy.onnx").read_bytes())
    data[len(data) // 2] ^= 1
    (copy / "policy.onnx").write_bytes(data)
    with pytest.raises(PolicyError, match=r"policy\.onnx: is not the network .* SHA-256 begins with"):
        Driver.load(copy)


WRONG: list[tuple[tuple[str | int, ...], object, str]] = [
    (("format",), "zebrat-deploy-2", "its format is 'zebrat-deploy-2'"),
    (("name",), 3, "policy.name must be a text, got 3"),
    (("name",), " ", "a policy has a name"),
    (("surplus",), 1, "policy needs exactly"),
    (("car", "wheelbase_m"), "0.56", "policy.car.wheelbase_m must be a finite number, got '0.56'"),
    (("car", "wheelbase_m"), -1.0, "wheelbase_m must be a finite number above 0"),
    (("car", "colour"), "red", "policy.car needs exactly"),
    (("car", "max_speed_mps"), 1.0, "limits are not those of the observation"),
    (("car", "outline_base", 0), [1.0], "is a list of 2"),
    (("control_step_s",), math.nan, "control_step_s must be a finite number, got nan"),
    (("control_step_s",), 99.0, "control_step_s is 0.001 to 10"),
    (("scan", "n_bearings"), 361, "bearing_step_rad contradicts the rest"),
    (("scan", "n_bearings"), True, "n_bearings must be a whole number, got True"),
    (("scan", "height_min_m"), 3.0, "height_min_m 3.0 must be below"),
    (("scan", "lidar_rotation_base"), [[1, 0, 0], [0, 1, 0], [0, 0, 2]], "is no rotation"),
    (("safety_region", "indices", 0), 360, "indices are 0 to 359"),
    (("safety_region", "indices", 0), 1.5, "must be a whole number, got 1.5"),
    (("safety_region", "indices", 0), 1, "bearings_rad.0. contradicts the rest"),
    (("safety_region", "range_m"), [1.0] * 31, "32 indices and 31 ranges"),
    (("safety_region", "range_m", 0), 0.5, "gaps are measured from other ranges"),
    (("safety_region",), [], "safety_region is no mapping"),
    (("observation", "n_rays"), 0, "n_rays must be 1 to 36000"),
    (("observation", "waypoint"), True, "observes the next waypoint"),
    (("observation", "raw"), True, "action.parts.0..times contradicts the rest"),
    (("observation", "last_command"), False, "policy.model.input"),
    (("observation", "parts", 0, "most"), 7.0, "most contradicts the rest: it must be 6.0, got 7.0"),
    (("action", "parts", 1, "times"), 1.0, "times contradicts the rest"),
    (("model", "file"), "/tmp/other.onnx", "file contradicts the rest"),
    (("model", "sha256"), "0" * 64, "SHA-256 begins with"),
]


@pytest.mark.parametrize(("keys", "value", "said"), WRONG, ids=lambda part: str(part)[:40])
def test_a_definition_that_is_wrong_or_contradicts_itself_is_refused(copy, keys, value, said):
    change(copy / "policy.json", *keys, to=value)
    with pytest.raises(PolicyError, match=said) as refused:
        Driver.load(copy)
    assert str(copy) in str(refused.value) and "zebrat export" in str(refused.value)


@pytest.mark.parametrize("text", ["[]", "3", "[" * 100_000, '{"format": 1e999}', "{'format': 1}"])
def test_a_definition_that_is_no_mapping_is_refused(copy, text):
    (copy / "policy.json").write_text(text, encoding="utf-8")
    with pytest.raises(PolicyError, match=r"policy\.json"):
        Driver.load(copy)


def network(
    nodes: list[onnx.NodeProto], weights: list[onnx.TensorProto], n_in: int = 66, n_out: int = 2, **more: object
):
    ends = [helper.make_tensor_value_info(*end) for end in (
        ("observation", TensorProto.FLOAT, ["N", n_in]), ("action", TensorProto.FLOAT, ["N", n_out])
    )]  # fmt: skip
    graph = helper.make_graph(nodes, "g", ends[:1], ends[1:], weights)
    return helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 17)], **more)


def weight(*shape: int, value: float = 0.0) -> onnx.TensorProto:
    return numpy_helper.from_array(np.full(shape, value, np.float32), "w")


def outside() -> onnx.ModelProto:
    tensor = weight(66, 2)
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/passwd")
    return network([helper.make_node("Gemm", ["observation", "w"], ["action"])], [tensor])


def inner() -> onnx.ModelProto:
    model = network([helper.make_node("Gemm", ["observation", "w"], ["action"])], [weight(66, 2)])
    model.graph.node[0].attribute.append(helper.make_attribute("body", model.graph))
    return model


def with_function() -> onnx.ModelProto:
    model = network([helper.make_node("Gemm", ["observation", "w"], ["action"])], [weight(66, 2)])
    body = [helper.make_node("Relu", ["x"], ["y"])]
    model.functions.append(helper.make_function("own", "f", ["x"], ["y"], body, [helper.make_opsetid("", 17)]))
    return model


MODELS: dict[str, tuple[Callable[[], onnx.ModelProto], str]] = {
    "other operation": (lambda: network([helper.make_node("Softmax", ["observation"], ["action"])], []),
                        "the operation 'Softmax'; allowed are ArgMax, Clip"),
    "other domain": (lambda: network([helper.make_node("Gemm", ["observation", "w"], ["action"], domain="my.code")],
                                     [weight(66, 2)]), "an operation of the domain 'my.code'"),
    "weights outside": (outside, "its weights lie in another file"),
    "graph within": (inner, "an operation holds a graph"),
    "functions": (with_function, "functions of its own"),
    "other input": (lambda: network([helper.make_node("Gemm", ["observation", "w"], ["action"])], [weight(34, 2)], 34),
                    "its input must be 'observation', N x 66 float32"),
    "other output": (lambda: network([helper.make_node("Gemm", ["observation", "w"], ["action"])], [weight(66, 3)],
                                     n_out=3), "its output must be 'action', N x 2"),
    "not finite": (lambda: network([helper.make_node("Gemm", ["observation", "w", "b"], ["action"])], [weight(66, 2),
                   numpy_helper.from_array(np.full(2, np.nan, np.float32), "b")]), "its action for zeros is"),
}  # fmt: skip


@pytest.mark.parametrize("case", MODELS)
def test_a_network_of_anything_but_plain_layers_is_refused_though_its_hash_is_right(copy, case):
    made, said = MODELS[case]
    model_file(copy, made())
    with pytest.raises(PolicyError, match=said):
        Driver.load(copy)


def test_a_plain_network_of_another_hand_is_taken(copy):
    model_file(copy, network([helper.make_node("Gemm", ["observation", "w"], ["action"])], [weight(66, 2, value=0.0)]))
    assert Driver.load(copy).drive_scan(FREE).command == Command(0.0, 0.0)


# Where nothing but numpy and ONNX Runtime is.

BARE = """
import sys

class Bare:
    allowed = {allowed} | set(sys.stdlib_module_names)
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] not in self.allowed:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Bare())
"""
_DRIVING = {"zebrat_bullet", "numpy", "onnxruntime"}


def bare(code: str, allowed: set[str]) -> subprocess.CompletedProcess:
    """Run Python where no other package than these can be imported."""
    text = BARE.format(allowed=sorted(allowed)).replace("= [", "= set([").replace("] |", "]) |") + code
    return subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)


def test_it_drives_where_only_numpy_and_onnxruntime_are(folder, tmp_path):
    np.save(tmp_path / "cloud.npy", a_cloud())
    code = f"""
import importlib, pkgutil
import numpy as np
import zebrat_bullet.deploy
from zebrat_bullet.deploy import Driver
for module in pkgutil.iter_modules(zebrat_bullet.deploy.__path__):
    importlib.import_module("zebrat_bullet.deploy." + module.name)
decision = Driver.load({str(folder)!r}).drive_cloud(np.load({str(tmp_path / "cloud.npy")!r}))
assert not decision.refusal
print(repr((decision.command.speed_mps, decision.command.steering_rad)))
print(sorted({{name.partition(".")[0] for name in sys.modules}} & {{"torch", "pybullet", "onnx"}}))
"""
    done = bare(code, _DRIVING)
    assert done.returncode == 0, done.stderr
    command, loaded = done.stdout.splitlines()
    here = Driver.load(folder).drive_cloud(a_cloud()).command
    assert eval(command) == (here.speed_mps, here.steering_rad) and loaded == "[]"


def test_without_onnxruntime_it_says_what_to_install(folder):
    done = bare(f"from zebrat_bullet.deploy import Driver\nDriver.load({str(folder)!r})", _DRIVING - {"onnxruntime"})
    assert "PolicyError: an exported policy runs with ONNX Runtime, which is not installed" in done.stderr


def test_the_command_line_loads_with_numpy_alone_and_says_what_a_command_lacks():
    def told(*arguments: str) -> subprocess.CompletedProcess:
        return bare(
            f"from zebrat_bullet.cli import main\nsys.exit(main({list(arguments)}))", {"zebrat_bullet", "numpy"}
        )

    helped = told("--help")
    assert helped.returncode == 0 and "export" in helped.stdout, helped.stderr
    done = told("export", "shipped")
    assert done.returncode == 2
    assert "zebrat export: needs pydantic, which is not installed" in done.stderr


def test_a_definition_is_small(folder, tmp_path):
    assert len(json.dumps(json.loads((folder / "policy.json").read_text(encoding="utf-8")))) < 10_000
    export_policy(str(random_policy("argmax", "relu", tmp_path)), tmp_path / "out")
    assert Driver.load(tmp_path / "out").definition.actions.raw is False


@pytest.mark.parametrize(
    ("was", "now"), [('"control_step_s": 0.2', '"control_step_s": 2.0'), ('"wheelbase_m": 0.56', '"wheelbase_m": 0.06')]
)
def test_a_definition_that_was_changed_afterwards_is_refused(copy, was, now):
    path = copy / "policy.json"
    assert was in path.read_text(encoding="utf-8")
    path.write_text(path.read_text(encoding="utf-8").replace(was, now), encoding="utf-8")
    with pytest.raises(PolicyError, match="was changed since it was written"):
        Driver.load(copy)


def test_a_last_command_that_is_no_number_is_refused_once(driver):
    driver.last_command = Command(math.nan, 0.0)
    assert "last_command must be finite" in driver.drive_cloud(a_cloud()).refusal
    assert not driver.drive_cloud(a_cloud()).refusal
