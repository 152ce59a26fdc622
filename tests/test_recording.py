"""What `zebrat record` writes is what happened, read back by two libraries that know nothing of this package."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from recorded import episode, task, world
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from zebrat_bullet.agents import load_agent
from zebrat_bullet.agents.supervised import supervised
from zebrat_bullet.cli import main
from zebrat_bullet.config import TaskConfig
from zebrat_bullet.config_text import from_json
from zebrat_bullet.evaluation.records import save_record
from zebrat_bullet.evaluation.rollout import run_episode
from zebrat_bullet.recording.episode import watch_episode
from zebrat_bullet.recording.schemas import _DEFINITIONS, schema_text
from zebrat_bullet.recording.write import TOPICS, write_recording
from zebrat_bullet.sensing.beams import beam_bearings
from zebrat_bullet.task.drive import Drive
from zebrat_bullet.types import Command

EPOCH_NS = 1_704_067_200 * 10**9


def mcap_ros2(path):
    """(Time of arrival in ns, message) of each topic, decoded by mcap-ros2-support by the schemas in the file."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        found = {}
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema.encoding == "ros2msg" and channel.message_encoding == "cdr"
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


def rosbags(path):
    """The same, decoded by rosbags."""
    found = {}
    with AnyReader([path]) as reader:
        for connection, time_ns, data in reader.messages():
            found.setdefault(connection.topic, []).append((time_ns, reader.deserialize(data, connection.msgtype)))
    return found


READERS = {"mcap-ros2-support": mcap_ros2, "rosbags": rosbags}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "episode.mcap"
    write_recording(episode(), world(), path)
    return path


@pytest.fixture(scope="module", params=READERS)
def read(request, path):
    return READERS[request.param](path)


def stamp_ns(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def points_of(message):
    """The (16, 360, 3) points of our clouds, by the layout that the message declares."""
    offsets = {field.name: field.offset for field in message.fields}
    assert [(f.name, f.datatype, f.count) for f in message.fields[:3]] == [(axis, 7, 1) for axis in "xyz"]
    data = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, message.row_step)
    points = data[:, : message.width * message.point_step].reshape(message.height, message.width, message.point_step)
    order = ">" if message.is_bigendian else "<"
    at = [np.ascontiguousarray(points[..., offsets[axis] : offsets[axis] + 4]).view(order + "f4") for axis in "xyz"]
    return np.concatenate(at, axis=-1)


def test_every_topic_holds_a_message_for_each_step(read):
    n = len(episode().record.command)
    steps = {"/tf", "/odom", "/points", "/scan", "/safety_region"}
    commands = {"/command", "/command_ackermann"}
    expected = dict.fromkeys(steps, n + 1) | dict.fromkeys(commands, n)
    assert {topic: len(found) for topic, found in read.items()} == expected | {
        "/tf_static": 1,
        "/walls": 1,
        "/outcome": 1,
    }


def test_stamps_are_simulated_time_from_a_fixed_day(read):
    times = episode().record.time_s
    for topic in ("/odom", "/points", "/scan"):
        assert [time_ns - EPOCH_NS for time_ns, _ in read[topic]] == [round(t * 1e9) for t in times]
        assert all(stamp_ns(message) == time_ns for time_ns, message in read[topic])
    assert [time_ns - EPOCH_NS for time_ns, _ in read["/command"]] == [round(t * 1e9) for t in times[:-1]]


def test_a_cloud_is_what_the_lidar_saw_and_nan_where_it_saw_nothing(read):
    seen = episode()
    n_missing = 0
    for (_, message), at in zip(read["/points"], seen.seen, strict=True):
        cloud = seen.drive.lidar.cloud(at.sweep)
        points = points_of(message).reshape(-1, 3)
        assert len(points) == 5760 and message.header.frame_id == "lidar"
        assert np.array_equal(points[cloud.valid], cloud.points_lidar[cloud.valid])
        assert np.isnan(points[~cloud.valid]).all()
        n_missing += (~cloud.valid).sum()
    assert n_missing > 0


def test_a_scan_is_the_record_s_and_inf_where_the_way_is_free(read):
    record = episode().record
    for (_, message), ranges in zip(read["/scan"], record.scan_m, strict=True):
        expected = np.where(ranges < 6.0, ranges, np.inf)
        assert np.array_equal(np.array(message.ranges, np.float32), expected.astype(np.float32))
        bearings = message.angle_min + message.angle_increment * np.arange(360)
        assert np.allclose(bearings, beam_bearings(360), atol=1e-5)
        assert message.angle_max == pytest.approx(bearings[-1], abs=1e-5)


def test_odometry_and_transforms_say_where_the_car_was(read):
    record = episode().record
    for (_, odometry), (_, tf), pose, speed in zip(
        read["/odom"], read["/tf"], record.pose, record.speed_mps, strict=True
    ):
        (transform,) = tf.transforms
        at, to = odometry.pose.pose, transform.transform
        assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", "base_link")
        assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")
        assert (at.position.x, at.position.y) == (to.translation.x, to.translation.y) == (pose[0], pose[1])
        for q in (at.orientation, to.rotation):
            assert Rotation.from_quat([q.x, q.y, q.z, q.w]).as_euler("xyz")[2] == pytest.approx(pose[2], abs=1e-6)
        assert odometry.twist.twist.linear.x == speed


def test_the_twist_of_the_odometry_is_how_its_frame_moves(read):
    record, twists = episode().record, [message.twist.twist for _, message in read["/odom"]]
    position, yaw = record.pose[:, :2], record.pose[:, 2]
    moved = np.gradient(position, record.time_s, axis=0)
    sideways = -np.sin(yaw) * moved[:, 0] + np.cos(yaw) * moved[:, 1]
    told = np.array([twist.linear.y for twist in twists])
    assert np.abs(told).max() > 0.05
    assert np.abs(told - sideways)[2:-2].max() < 0.05


def test_the_frames_hang_together_from_the_map_to_the_lidar(read):
    ((_, static),) = read["/tf_static"]
    origin, mount = static.transforms
    assert (origin.header.frame_id, origin.child_frame_id) == ("map", "odom")
    assert (mount.header.frame_id, mount.child_frame_id) == ("base_link", "lidar")
    at = mount.transform.translation
    assert [at.x, at.y, at.z] == episode().drive.robot.lidar_xyz_base.tolist()
    assert mount.transform.rotation.w == origin.transform.rotation.w == 1.0


def test_a_wall_s_points_in_the_map_lie_on_the_walls_that_are_drawn(read):
    """Clouds, moved through the recorded transforms, end where the markers of the walls are."""
    ((_, walls),) = read["/walls"]
    (marker,) = walls.markers
    corners = np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 3, 3)
    assert np.array_equal(corners, world().mesh.vertices[world().mesh.faces]) and marker.type == 11
    step = len(read["/points"]) // 2
    points = points_of(read["/points"][step][1]).reshape(-1, 3)
    mount, moved = read["/tf_static"][0][1].transforms[1].transform, read["/tf"][step][1].transforms[0].transform
    for frame in (mount, moved):
        q, t = frame.rotation, frame.translation
        points = Rotation.from_quat([q.x, q.y, q.z, q.w]).apply(points) + np.array([t.x, t.y, t.z])
    points = points[np.isfinite(points[:, 0]) & (points[:, 2] > 0.05)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    off = np.abs(np.einsum("pkd,kd->pk", points[:, None] - corners[None, :, 0], normals)).min(axis=1)
    assert len(points) > 1000 and np.quantile(off, 0.99) < 1e-3


def test_commands_are_the_record_s_in_both_forms(read):
    wheelbase = episode().drive.robot.wheelbase_m
    for (_, twist), (_, ackermann), (speed, steering) in zip(
        read["/command"], read["/command_ackermann"], episode().record.command, strict=True
    ):
        assert twist.twist.linear.x == speed
        assert twist.twist.angular.z == pytest.approx(speed * np.tan(steering) / wheelbase, abs=1e-12)
        assert (ackermann.drive.speed, ackermann.drive.steering_angle) == (np.float32(speed), np.float32(steering))


def test_the_safety_region_s_rays_end_at_v_range(read):
    region, record = episode().drive.region, episode().record
    lidar = episode().drive.robot.lidar_xyz_base[:2]
    for _, message in read["/safety_region"]:
        outline, rays = message.markers
        assert (outline.type, rays.type, outline.header.frame_id) == (4, 5, "base_link")
        assert len(outline.points) == len(region.outline_lidar) + 1
        points = np.array([(p.x, p.y) for p in rays.points]).reshape(-1, 2, 2)
        assert np.array_equal(points[:, 0], np.broadcast_to(lidar, (32, 2)))
        assert np.allclose(np.hypot(*(points[:, 1] - lidar).T), record.range_m, atol=1e-6)
        assert {(c.r > 0.8, c.g > 0.8) for c in rays.colors} == {(False, False)}  # nothing fires in this drive


class Turning:
    """Drives on at full lock, into the wall."""

    name, privileged = "turning", frozenset()

    def reset(self, seed):
        pass

    def act(self, reading):
        return Command(0.6, 0.6)


def test_bearings_that_fire_are_red(tmp_path):
    wide = replace(task(), region=replace(task().region, margin_m=0.1))
    crashed = watch_episode(wide, world(), Turning(), seed=0, episode=0)
    write_recording(crashed, world(), tmp_path / "crash.mcap")
    read = rosbags(tmp_path / "crash.mcap")
    last = read["/safety_region"][-1][1]
    red = np.array([colour.r > 0.8 for colour in last.markers[1].colors]).reshape(-1, 2)
    fires = crashed.record.obs_m[-1] <= crashed.record.range_m
    assert fires.any() and not fires.all()
    assert np.array_equal(red, np.stack([fires, fires], axis=1)) and last.markers[0].color.r > 0.8
    assert read["/outcome"][0][1].data == crashed.record.outcome == "collision"


def test_watching_an_episode_does_not_change_it():
    drive = Drive(task(), world())
    record = run_episode(drive, load_agent("shipped", task()), 0, 0)
    drive.close()
    assert np.array_equal(record.pose, episode().record.pose) and record.outcome == "success"


def test_the_same_episode_gives_the_same_bytes_from_an_agent_and_from_its_record(path, tmp_path, capfd):
    again, replayed = tmp_path / "again.mcap", tmp_path / "replayed.mcap"
    assert main(["record", "--agent", "shipped", "--world", "real_1", "--out", str(again), "--json"]) == 0
    told = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert told["outcome"] == "success" and told["megabytes"] == round(again.stat().st_size / 1e6, 3)
    save_record(episode().record, tmp_path / "episode.npz")
    assert main(["record", str(tmp_path / "episode.npz"), "--out", str(replayed)]) == 0
    assert path.read_bytes() == again.read_bytes() == replayed.read_bytes()


def test_the_file_says_which_episode_it_is(path):
    with path.open("rb") as file:
        (metadata,) = make_reader(file).iter_metadata()
    assert metadata.name == "zebrat" and metadata.metadata["world"] == "real_1"
    assert from_json(TaskConfig, metadata.metadata["task"]) == episode().drive.config


def test_walls_and_fixed_frames_are_latched(path):
    with AnyReader([path]) as reader:
        durability = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in reader.connections}
        kinds = {c.topic: c.msgtype for c in reader.connections}
    assert {topic for topic, how in durability.items() if how == "TRANSIENT_LOCAL"} == {"/tf_static", "/walls"}
    assert kinds == TOPICS


def test_a_recording_is_small(path):
    clouds = len(episode().seen) * 5760 * 16
    assert path.stat().st_size < 0.7 * clouds


@pytest.mark.parametrize("store", [Stores.ROS2_JAZZY, Stores.ROS2_KILTED, Stores.ROS2_HUMBLE])
def test_definitions_are_those_of_ros(store):
    known = get_typestore(store).fielddefs
    for name in _DEFINITIONS:
        for kind, (_, fields) in get_types_from_msg(schema_text(name), name).items():
            assert kind in known or kind.startswith("ackermann_msgs/")
            assert fields == known.get(kind, (None, fields))[1], kind


def test_definitions_are_those_of_the_ros_packages_installed_here():
    share = Path(sys.prefix) / "share"
    files = {name: share / f"{name}.msg" for name in _DEFINITIONS}
    there = {name: file for name, file in files.items() if file.is_file()}
    if not there:
        pytest.skip("no ROS message packages here")
    for name, file in there.items():
        ours = get_types_from_msg(schema_text(name), name)[name][1]
        assert ours == get_types_from_msg(file.read_text(encoding="utf-8"), name)[name][1], name


def test_a_supervised_drive_tells_why_it_was_stopped(tmp_path):
    short = replace(task(), episode=replace(task().episode, max_steps=40))
    stopped = watch_episode(short, world(), supervised(Turning(), short, 0.02), seed=0, episode=0)
    write_recording(stopped, world(), tmp_path / "stopped.mcap")
    told = rosbags(tmp_path / "stopped.mcap")["/supervisor"]
    assert [message.data for _, message in told] == list(stopped.record.reasons) and told
    steps = stopped.record.refused[:, 0].astype(int)
    assert [t - EPOCH_NS for t, _ in told] == [round(t * 1e9) for t in stopped.record.time_s[steps]]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--out", "drive.mp4"], "a recording's name ends in .mcap"),
        (["there_is_none.npz"], "no such file"),
        (["some.npz", "--world", "track_2"], "says itself who drove where"),
        (["--set", "lidar.range_max_m=4"], "--set takes settings as task.KEY=VALUE"),
        (["--agent", "nobody"], "no agent 'nobody'"),
        (["drive.mcap"], "drive.mcap is a recording already; a record is an .npz that `zebrat evaluate` wrote"),
        (["drive.MCAP", "--world", "real_1"], "is a recording already"),
    ],
)
def test_what_cannot_be_recorded_is_refused(arguments, said, capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["record", *arguments]) == 2
    assert said in capfd.readouterr().err
    assert not list(tmp_path.iterdir())


def test_without_the_packages_it_says_which_to_install():
    code = (
        "import sys\n"
        "class Gone:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name.partition('.')[0] in ('rosbags', 'mcap', 'mcap_ros2'):\n"
        "            raise ModuleNotFoundError(f'No module named {name!r}', name=name)\n"
        "sys.meta_path.insert(0, Gone())\n"
        "from zebrat_bullet.cli import main\n"
        "sys.exit(main(['record', '--world', 'real_1']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2 and "pip install 'zebrat-bullet[record]'" in done.stderr
