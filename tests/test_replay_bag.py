"""`zebrat replay --bag`: a policy on bags, ours and a user's own; what differs, where; and what is refused."""

import csv
import json
import struct
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import zstandard
from bags import ACKERMANN, CLOUD, SCAN, TWIST, TWIST_STAMPED, Messages, write_bag
from recorded import episode, task, world
from rosbags.rosbag2 import CompressionFormat, CompressionMode
from rosbags.typesys import Stores

from zebrat_bullet.agents import load_agent
from zebrat_bullet.cli import main
from zebrat_bullet.config import FlattenConfig, TaskConfig
from zebrat_bullet.deploy.driver import Limits
from zebrat_bullet.errors import ConfigError, SensorError, ZebratError
from zebrat_bullet.evaluation.own_task import as_trained
from zebrat_bullet.recording.bag import Bag
from zebrat_bullet.recording.differences import summary
from zebrat_bullet.recording.messages import scan_message
from zebrat_bullet.recording.open_loop import Reader, run_open_loop
from zebrat_bullet.recording.senses import Eyes, Mount
from zebrat_bullet.recording.topics import choose_topics
from zebrat_bullet.recording.unpack import unzstd
from zebrat_bullet.recording.write import write_recording
from zebrat_bullet.robot import load_robot
from zebrat_bullet.types import Command, FlatScan

TIGHT = (1e-6, 1e-6)


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    path = tmp_path_factory.mktemp("ours") / "episode.mcap"
    write_recording(episode(), world(), path)
    return path


def open_loop(path, lidar="", command="", odometry="", agent="shipped", reader=None, policy=None, its=None):
    with Bag(path) as bag:
        topics, its = choose_topics(bag, lidar, command, odometry), its or task()
        return run_open_loop(bag, topics, policy or load_agent(agent, its), its, reader)


def clouds(n=None):
    """The returns of each cloud of the episode, as a Velodyne's driver sends them: rays without one are left out."""
    for seen in episode().seen[:n]:
        cloud = episode().drive.lidar.cloud(seen.sweep)
        yield cloud.points_lidar[cloud.valid]


def users_drive(messages, kind=CLOUD, command=TWIST_STAMPED, n=20, answer_s=0.03):
    """A user's own recording of the first steps: other topics and frames, from scan to command a few ms."""
    wheelbase = episode().drive.robot.wheelbase_m
    record = episode().record
    for i, points in enumerate(clouds(n)):
        time_s = 0.2 * i
        if kind == CLOUD:
            yield "/velodyne_points", kind, time_s, messages.cloud(points, time_s, "velodyne")
        else:
            ahead_first = np.roll(np.where(record.scan_m[i] < 6.0, record.scan_m[i], np.inf), -180)
            yield "/front/scan", kind, time_s, messages.scan(ahead_first, time_s, "laser")
        speed, steering = record.command[i].tolist()
        turning, then = speed * np.tan(steering) / wheelbase, time_s + answer_s
        made = {
            TWIST: lambda s=speed, t=turning: messages.twist(s, t),
            TWIST_STAMPED: lambda s=speed, t=turning, at=then: messages.twist_stamped(s, t, at),
            ACKERMANN: lambda s=speed, a=steering, at=then: messages.ackermann(s, a, at),
        }
        yield "/cmd_vel", command, then, made[command]()


@pytest.mark.parametrize("lidar", ["/points", "/scan"])
@pytest.mark.parametrize("command", ["/command", "/command_ackermann"])
def test_the_policy_that_drove_gives_the_recorded_commands_again(ours, lidar, command):
    loop = open_loop(ours, lidar, command)
    found = summary(loop, TIGHT)
    assert found["compared"] == found["within"] == len(episode().record.command) > 40
    assert found["unanswered"] == 1 and not found["refused"] and not found["unusable"]  # the last reading ends it
    commands = np.array([(a.command.speed_mps, a.command.steering_rad) for a in loop.answers[:-1]])
    assert np.abs(commands - episode().record.command).max() < 1e-6


def test_cloud_and_ackermann_are_read_where_nothing_is_named(ours):
    with Bag(ours) as bag:
        topics = choose_topics(bag)
    assert (topics.lidar.name, topics.command.name) == ("/points", "/command_ackermann")
    assert topics.odometry.name == "/odom"


def test_the_last_command_is_fed_as_it_was_recorded(ours):
    """A policy that repeats what it is told last shows what it is told: the recorded commands, one step late."""

    class Repeating:
        name, privileged = "repeating", frozenset()

        def reset(self, seed):
            pass

        def act(self, reading):
            return reading.last_command

    told = [(a.command.speed_mps, a.command.steering_rad) for a in open_loop(ours, policy=Repeating()).answers]
    assert told[0] == (0.0, 0.0)
    assert np.abs(np.array(told[1:]) - episode().record.command).max() < 1e-6


def test_the_speed_is_the_odometry_s_or_else_the_last_command_s(ours, tmp_path):
    class Watching:
        name, privileged = "watching", frozenset()

        def reset(self, seed):
            self.speeds = []

        def act(self, reading):
            self.speeds.append(reading.speed_mps)
            return Command(0.0, 0.0)

    watching = Watching()
    open_loop(ours, policy=watching)
    assert np.array_equal(watching.speeds, episode().record.speed_mps)
    bag = write_bag(tmp_path / "bag", Messages(), users_drive(Messages()))
    open_loop(bag, policy=watching)
    assert np.allclose(watching.speeds, [0.0, *episode().record.command[:19, 0]], atol=1e-6)


def test_another_policy_differs_where_it_decides_otherwise(ours):
    """The differences are those of the other policy, asked with the record's own readings."""
    from zebrat_bullet.types import Clearance, FlatScan, Reading

    record, other = episode().record, load_agent("il", task())
    loop = open_loop(ours, agent="il")
    last = Command(0.0, 0.0)
    for i, answer in enumerate(loop.answers[:-1]):
        scan = FlatScan(record.scan_m[i], 6.0)
        reading = Reading(scan, Clearance(record.obs_m[i], record.range_m, False), last, 0.0, 0.0)
        wanted, last = other.act(reading), Command(*record.command[i].tolist())
        assert answer.speed_error_mps == pytest.approx(wanted.speed_mps - last.speed_mps, abs=1e-5)
        assert answer.steering_error_rad == pytest.approx(wanted.steering_rad - last.steering_rad, abs=1e-5)
    found = summary(loop)
    assert found["compared"] - found["within"] > 0


def test_one_other_command_is_found_at_its_place(tmp_path):
    messages = Messages()
    sent = list(users_drive(messages, command=ACKERMANN))
    message = sent[2 * 13 + 1][3]
    message.drive.steering_angle -= 0.25
    message.drive.speed -= 0.125
    bag = write_bag(tmp_path / "bag", messages, sent)
    found = summary(open_loop(bag))
    assert found["compared"] - found["within"] in (1, 2)  # and perhaps the next, which is told another last command
    worst = found["largest"]
    assert worst["speed_error_mps"] == {"time_s": pytest.approx(2.6), "value": pytest.approx(0.125, abs=1e-6)}
    assert worst["steering_error_rad"] == {"time_s": pytest.approx(2.6), "value": pytest.approx(0.25, abs=1e-6)}


@pytest.mark.parametrize("storage", ["sqlite3", "mcap", "ros1"])
@pytest.mark.parametrize("kind", [CLOUD, SCAN])
@pytest.mark.parametrize("command", [TWIST, TWIST_STAMPED, ACKERMANN])
def test_a_user_s_own_bag_is_read(tmp_path, storage, kind, command):
    messages = Messages(Stores.ROS1_NOETIC if storage == "ros1" else Stores.ROS2_HUMBLE)
    path = tmp_path / ("drive.bag" if storage == "ros1" else "drive")
    loop = open_loop(write_bag(path, messages, users_drive(messages, kind, command), storage))
    found = summary(loop, TIGHT)
    assert found["compared"] == found["within"] == 20
    assert loop.frame == ("velodyne" if kind == CLOUD else "laser")


def test_a_bag_whose_messages_are_compressed_is_read(tmp_path):
    how = {"mode": CompressionMode.MESSAGE, "fmt": CompressionFormat.ZSTD}
    bag = write_bag(tmp_path / "bag", Messages(), users_drive(Messages()), **how)
    assert summary(open_loop(bag), TIGHT)["within"] == 20


def test_a_bag_in_several_files_is_read_as_one(tmp_path):
    sent = list(users_drive(Messages()))
    folder = write_bag(tmp_path / "one", Messages(), sent[:20])
    write_bag(tmp_path / "two", Messages(), sent[20:])
    (tmp_path / "two" / "two.db3").rename(folder / "one_1.db3")
    assert summary(open_loop(folder), TIGHT)["within"] == 20


def test_a_twist_at_standstill_says_nothing_of_the_steering(tmp_path):
    messages = Messages()
    sent = list(users_drive(messages, n=4))
    sent[3] = (*sent[3][:3], messages.twist_stamped(0.0, 0.0, 0.23))
    loop = open_loop(write_bag(tmp_path / "bag", messages, sent))
    stopped = loop.answers[1]
    assert stopped.recorded.speed_mps == 0.0 and np.isnan(stopped.recorded.steering_rad)
    assert stopped.speed_error_mps == stopped.command.speed_mps


def test_a_twist_may_carry_the_steering_itself(tmp_path):
    messages, commands = Messages(), episode().record.command
    sent = [
        (topic, kind, t, messages.twist_stamped(*commands[i // 2].tolist(), t) if i % 2 else message)
        for i, (topic, kind, t, message) in enumerate(users_drive(messages))
    ]
    bag = write_bag(tmp_path / "bag", messages, sent)
    assert summary(open_loop(bag, reader=Reader(twist_steers=True)), TIGHT)["within"] == 20
    assert summary(open_loop(bag), TIGHT)["within"] < 20


def test_a_command_answers_the_scan_before_it_or_after_a_delay(tmp_path):
    """Commands that come 0.25 s after their scan answer the next one, unless the delay is told."""
    bag = write_bag(tmp_path / "bag", Messages(), sorted(users_drive(Messages(), answer_s=0.25), key=lambda s: s[2]))
    late = open_loop(bag)
    assert [a.recorded is None for a in late.answers][:2] == [True, False]
    told = open_loop(bag, reader=Reader(delay_s=0.22))
    recorded = np.array([(a.recorded.speed_mps, a.recorded.steering_rad) for a in told.answers])
    assert np.allclose(recorded, episode().record.command[:20], atol=1e-6)


def test_a_scan_that_no_command_answers_is_not_compared(tmp_path):
    sent = [each for i, each in enumerate(users_drive(Messages())) if i != 11]
    found = summary(open_loop(write_bag(tmp_path / "bag", Messages(), sent)), TIGHT)
    assert (found["compared"], found["unanswered"]) == (19, 1)


def test_a_lidar_mounted_otherwise_is_read_by_its_mount():
    """A wall 0.1 m above the floor, 2 m to the left of a lidar turned by 90 degrees and 0.5 m up."""
    points = np.array([[2.0, y, -0.4] for y in np.linspace(-0.5, 0.5, 200)], np.float32)
    low = replace(task(), flatten=FlattenConfig(height_min_m=0.05, height_max_m=0.15))
    mount = Mount(height_m=0.5, rpy_rad=(0.0, 0.0, np.pi / 2.0))
    anywhere = Limits(least_sector_points=0)
    scan = Eyes(low, mount, np.arange(0), anywhere).cloud(Messages().cloud(points))
    assert scan.ranges_m[270] == pytest.approx(2.0, abs=0.01) and (scan.ranges_m < 6.0).sum() > 20
    assert scan.ranges_m[:180].min() == 6.0
    higher = Eyes(low, replace(mount, height_m=0.7), np.arange(0), anywhere).cloud(Messages().cloud(points))
    assert higher.ranges_m.min() == 6.0
    with pytest.raises(SensorError, match="an eighth of the turn"):  # as on the car
        Eyes(low, mount, np.arange(0)).cloud(Messages().cloud(points))


def test_a_policy_with_a_memory_is_asked_once_a_control_step_of_a_faster_lidar(tmp_path):
    messages = Messages()
    bags = {}
    for n_times in (1, 2):
        seen = [
            ("/points", CLOUD, 0.2 * i + 0.1 * k, messages.cloud(points, 0.2 * i + 0.1 * k))
            for i, points in enumerate(clouds(20))
            for k in range(n_times)
        ]
        told = [
            ("/cmd", ACKERMANN, 0.2 * i + 0.01, messages.ackermann(*command, 0.2 * i))
            for i, command in enumerate(episode().record.command[:20].tolist())
        ]
        bags[n_times] = write_bag(tmp_path / f"{n_times}", messages, sorted([*told, *seen], key=lambda each: each[2]))
    its, _ = as_trained(TaskConfig(), "allround", own_robot=True)
    once, twice = (open_loop(bags[n], agent="allround", its=its) for n in (1, 2))
    assert (once.n_early, twice.n_early) == (0, 20)
    assert [answer.command for answer in twice.answers] == [answer.command for answer in once.answers]
    assert open_loop(bags[2]).n_early == 0  # without one every scan is looked at


@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.0, 0.0, 1.3), (np.pi, 0.0, -0.7)])
def test_a_recorded_scan_is_told_in_the_frame_of_the_lidar_as_it_is_mounted(rpy):
    scan = FlatScan(episode().record.scan_m[5], 6.0)
    made = scan_message(scan, replace(load_robot("zebrat"), lidar_rpy=np.array(rpy)), 0.2, 1.0)
    stamped = SimpleNamespace(**made | {"header": SimpleNamespace(frame_id="lidar"), "range_min": 0.0})
    seen = Eyes(task(), Mount(height_m=0.75, rpy_rad=rpy), np.arange(0)).scan(stamped)
    assert np.abs(seen.ranges_m - scan.ranges_m).max() < 1e-6
    if rpy == (0.0, 0.0, 0.0):
        assert made["angle_min"] == -np.pi and made["angle_increment"] == 2.0 * np.pi / 360


def ouster(points, messages):
    """An Ouster's cloud: organised, 48 bytes a point, big-endian, each row padded."""
    rows = points[: len(points) // 16 * 16].reshape(16, -1, 3)
    kind = np.dtype({"names": ["xyz", "t"], "formats": [(">f4", 3), ">u4"], "offsets": [4, 20], "itemsize": 48})
    packed = np.zeros(rows.shape[:2], kind)
    packed["xyz"] = rows
    data = b"".join(row.tobytes() + b"\xff" * 64 for row in packed)
    field = messages.store.types["sensor_msgs/msg/PointField"]
    fields = [field(name=axis, offset=4 + 4 * i, datatype=7, count=1) for i, axis in enumerate("xyz")]
    layout = {"height": 16, "width": rows.shape[1], "point_step": 48, "row_step": 48 * rows.shape[1] + 64}
    data_as_array = np.frombuffer(data, np.uint8)
    return messages.cloud(points, fields=fields, is_bigendian=True, data=data_as_array, **layout)


def test_clouds_of_any_layout_give_the_same_scan():
    mount = Mount(height_m=0.75, rpy_rad=(0.0, 0.0, 0.0))
    eyes, messages = Eyes(task(), mount, np.arange(0)), Messages()
    points = next(clouds(1))[:5000]
    plain = eyes.cloud(messages.cloud(points)).ranges_m
    assert np.array_equal(eyes.cloud(ouster(points, messages)).ranges_m, plain)
    with_gaps = np.concatenate([points, np.full((50, 3), np.nan), np.zeros((50, 3)), np.full((50, 3), np.inf)])
    assert np.array_equal(eyes.cloud(messages.cloud(with_gaps)).ranges_m, plain)


BAD_MESSAGES = {
    "no point at all": (lambda m, p: m.cloud(p[:0]), "0 of 0 points are returns"),
    "nothing but nan": (lambda m, p: m.cloud(np.full((500, 3), np.nan)), "0 of 500 points are returns"),
    "fewer bytes than it says": (lambda m, p: m.cloud(p, width=len(p) + 1), "needs"),
    "a size beyond all": (lambda m, p: m.cloud(p, width=2**32 - 1, height=2**32 - 1), "needs"),
    "no field x": (lambda m, p: m.cloud(p, fields=m.cloud(p).fields[1:]), "must have the fields x, y and z"),
    "coordinates beside the point": (lambda m, p: m.cloud(p, point_step=8), "do not lie within a point of 8 bytes"),
    "points in the map": (lambda m, p: m.cloud(p, frame="map"), "frame 'map', by its name not the lidar's own"),
    "points about the car": (lambda m, p: m.cloud(p, frame="base_link"), "--lidar-frame base_link"),
    "garbage": (lambda m, p: b"\x00\x01\x00\x00" + bytes(range(200)), "bytes are no sensor_msgs/msg/PointCloud2"),
    "no bytes": (lambda m, p: b"", "0 bytes are no sensor_msgs/msg/PointCloud2"),
}


@pytest.mark.parametrize("name", BAD_MESSAGES)
def test_a_message_that_cannot_be_relied_on_is_a_stop_and_says_why(name, tmp_path):
    make, said = BAD_MESSAGES[name]
    messages = Messages()
    bad = make(messages, next(clouds(1)))
    sent = list(users_drive(messages, n=4))
    sent[4] = (*sent[4][:3], bad)
    loop = open_loop(write_bag(tmp_path / "one", messages, sent))
    assert [bool(answer.refusal) for answer in loop.answers] == [False, False, True, False]
    assert loop.answers[2].command.speed_mps == 0.0
    assert summary(loop)["refused"] == 1 and summary(loop)["compared"] == 3
    every = [(*each[:3], bad) if each[1] == CLOUD else each for each in sent]
    with pytest.raises(ZebratError, match="none of the 4 messages") as error:
        open_loop(write_bag(tmp_path / "every", messages, every))
    assert said in str(error.value)


BAD_SCANS = {
    "too coarse": (lambda m: m.scan(np.full(90, 2.0)), "a ray every 4 degrees"),
    "ahead only": (lambda m: m.scan(np.full(180, 2.0), angle_increment=np.pi / 180.0), "leaves out"),
    "nothing but nan": (lambda m: m.scan(np.full(360, np.nan)), "0 of 360 rays have a return"),
    "no ray": (lambda m: m.scan(np.zeros(0), angle_increment=0.0), "goes on by steps other than 0"),
    "steps that are no number": (lambda m: m.scan(np.full(360, 2.0), angle_increment=np.nan), "angle_increment nan"),
    "limits that are none": (lambda m: m.scan(np.full(360, 2.0), range_max=0.05), "below range_max"),
}


@pytest.mark.parametrize("name", BAD_SCANS)
def test_a_scan_that_cannot_be_relied_on_says_why(name):
    make, said = BAD_SCANS[name]
    eyes = Eyes(task(), Mount(height_m=0.75, rpy_rad=(0.0, 0.0, 0.0)), np.unique(episode().drive.region.indices))
    with pytest.raises(SensorError, match=said):
        eyes.scan(make(Messages()))


def test_a_frame_that_changes_is_refused_and_one_that_is_named_is_believed():
    points, messages = next(clouds(1)), Messages()
    eyes = Eyes(task(), Mount(height_m=0.75, rpy_rad=(0.0, 0.0, 0.0)), np.arange(0))
    eyes.cloud(messages.cloud(points, frame="front"))
    with pytest.raises(SensorError, match="'rear', expected 'front'"):
        eyes.cloud(messages.cloud(points, frame="rear"))
    named = Mount(height_m=0.75, rpy_rad=(0.0, 0.0, 0.0), frame="base_link")
    assert Eyes(task(), named, np.arange(0)).cloud(messages.cloud(points, frame="base_link"))


def test_commands_that_are_no_numbers_are_passed_over_and_counted(tmp_path):
    messages = Messages()
    sent = list(users_drive(messages, n=4))
    sent[1] = (*sent[1][:3], messages.twist_stamped(np.nan, 0.0))
    sent[3] = (*sent[3][:3], b"\x00\x01\x00\x00garbage")
    found = summary(open_loop(write_bag(tmp_path / "bag", messages, sent)))
    assert (found["unusable"], found["compared"], found["unanswered"]) == (2, 2, 2)


def test_two_topics_that_it_could_be_are_listed_and_one_can_be_named(tmp_path):
    messages = Messages()
    sent = list(users_drive(messages, SCAN))
    more = [("/rear/scan", SCAN, t + 0.001, message) for _, kind, t, message in sent if kind == SCAN]
    bag = write_bag(tmp_path / "bag", messages, sorted(sent + more, key=lambda each: each[2]))
    with pytest.raises(ConfigError, match=r"2 topics .*/front/scan .*/rear/scan .*--lidar-topic /front/scan"):
        open_loop(bag)
    assert summary(open_loop(bag, "/front/scan"), TIGHT)["within"] == 20
    assert summary(open_loop(bag, "front/scan"), TIGHT)["within"] == 20
    with pytest.raises(ConfigError, match=r"/nothing is not in the bag.* It holds: .*/cmd_vel"):
        open_loop(bag, "/nothing")
    with pytest.raises(ConfigError, match=r"--lidar-topic /cmd_vel is /cmd_vel \(geometry_msgs/msg/TwistStamped, 20\)"):
        open_loop(bag, "/cmd_vel")


@pytest.mark.parametrize(("left", "said"), [(TWIST_STAMPED, "PointCloud2 or sensor_msgs"), (CLOUD, "AckermannDrive")])
def test_a_bag_without_a_lidar_or_without_commands_lists_what_it_holds(left, said, tmp_path):
    sent = [each for each in users_drive(Messages()) if each[1] == left]
    with pytest.raises(ConfigError, match=rf"bag: has no messages of .*{said}.* It holds: /"):
        open_loop(write_bag(tmp_path / "bag", Messages(), sent))


def test_an_agent_that_needs_more_than_a_lidar_is_refused(ours):
    with pytest.raises(ConfigError, match=r"is to be told .*pose.*which no bag holds"):
        open_loop(ours, agent="oracle")


def bad_files(tmp_path, ours):
    whole = ours.read_bytes()
    users = write_bag(tmp_path / "users", Messages(), users_drive(Messages()))
    database = (users / "users.db3").read_bytes()
    at = whole.index(b"zstd") + 4 + 8 + 2000
    return {
        "empty.mcap": (b"", "is empty"),
        "empty.db3": (b"", "is empty"),
        "empty.bag": (b"", "is empty"),
        "cut.mcap": (whole[: len(whole) // 2], "no whole bag .*mcap recover"),
        "cut_in_the_head.mcap": (whole[:20], "no whole bag"),
        "changed.mcap": (whole[:at] + b"\x00" * 64 + whole[at + 64 :], "no whole bag"),
        "garbage.mcap": (bytes(range(256)) * 40, "no whole bag"),
        "garbage.db3": (bytes(range(256)) * 40, "no whole bag"),
        "garbage.bag": (bytes(range(256)) * 40, "no whole bag"),
        "cut.db3": (database[: len(database) // 2], "no whole bag"),
        "picture.png": (b"\x89PNG", "is no bag; name an .mcap, .db3, .bag file"),
    }


def test_damaged_and_foreign_files_are_refused_by_name(tmp_path, ours):
    for name, (data, said) in bad_files(tmp_path, ours).items():
        path = tmp_path / name
        path.write_bytes(data)
        with pytest.raises(ZebratError, match=said) as error:
            open_loop(path)
        assert name in str(error.value)


def test_folders_that_are_no_bags_are_refused(tmp_path):
    with pytest.raises(ZebratError, match="no such file"):
        open_loop(tmp_path / "nowhere")
    with pytest.raises(ZebratError, match=r"holds 0 \.mcap and \.db3 files"):
        open_loop(tmp_path)
    bag = write_bag(tmp_path / "bag", Messages(), users_drive(Messages(), n=2))
    (bag / "metadata.yaml").write_text("a: [1, 2", encoding="utf-8")
    with pytest.raises(ZebratError, match=r"metadata\.yaml: is not readable as YAML"):
        open_loop(bag)
    (bag / "metadata.yaml").write_text("a: 1", encoding="utf-8")
    with pytest.raises(ZebratError, match="ros2 bag reindex"):
        open_loop(bag)
    (bag / "metadata.yaml").unlink()  # as an interrupted recording leaves it
    assert len(open_loop(bag).answers) == 2
    (bag / "bag.db3").rename(bag / "bag.db3.zstd")
    with pytest.raises(ZebratError, match="compressed as a whole; unpack it first: zstd -d"):
        open_loop(bag)


def test_what_unpacks_to_more_than_it_says_is_refused():
    """A piece of 70 kB that would be 2 GB, and one that is what it says."""
    packed = zstandard.ZstdCompressor().compress(b"\x00" * 64_000_000)
    assert len(packed) < 10_000
    with pytest.raises(ValueError, match="unpacks to more than the 1000000 bytes"):
        unzstd(packed * 32, 1_000_000)
    assert unzstd(packed, 64_000_000) == b"\x00" * 64_000_000


def test_a_recording_whose_chunk_is_a_bomb_is_refused(tmp_path, ours):
    """Its chunk declares 100 bytes and holds 64 MB: it is not unpacked beyond those."""
    bomb = zstandard.ZstdCompressor().compress(b"\x00" * 64_000_000)
    head = ours.read_bytes()
    (length,) = struct.unpack_from("<Q", head, 9)
    chunk = struct.pack("<QQQI", 0, 1, 100, 0) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(bomb)) + bomb
    footer = b"\x02" + struct.pack("<QQQI", 20, 0, 0, 0)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(head[: 17 + length] + b"\x06" + struct.pack("<Q", len(chunk)) + chunk + footer + head[:8])
    with pytest.raises(ZebratError, match="unpacks to more than the 100 bytes"):
        open_loop(path)


def test_nothing_in_a_bag_becomes_code(tmp_path):
    """The definitions in the file are not looked at: one that is none changes nothing."""
    bag = write_bag(tmp_path / "bag", Messages(), users_drive(Messages()))
    path = bag / "bag.db3"
    data = path.read_bytes()
    changed = data.replace(b"std_msgs/Header header", b"__import__('os')._exit")
    assert changed != data
    path.write_bytes(changed)
    assert summary(open_loop(bag), TIGHT)["within"] == 20


def run(capfd, *arguments):
    status = main(["replay", *map(str, arguments)])
    said = capfd.readouterr()
    return status, said.out, said.err


def test_the_command_tells_and_writes_a_row_for_each_scan(tmp_path, capfd):
    bag = write_bag(tmp_path / "bag", Messages(), users_drive(Messages()))
    table = tmp_path / "table.csv"
    status, out, _ = run(capfd, "--bag", bag, "--agent", "il", "--out", table, "--json")
    told = json.loads(out.splitlines()[-1])
    rows = list(csv.DictReader(table.open()))
    assert status == 0 and told["lidar_topic"] == "/velodyne_points" and told["command_topic"] == "/cmd_vel"
    assert len(rows) == told["scans"] == 20 and sum(row["within"] == "1" for row in rows) == told["within"] < 20
    worst = told["largest"]["steering_error_rad"]
    (row,) = [row for row in rows if float(row["time_s"]) == worst["time_s"]]
    assert float(row["steering_error_rad"]) == worst["value"]
    assert max(abs(float(row["steering_error_rad"])) for row in rows) == abs(worst["value"])


def test_the_command_says_in_words_what_differs(tmp_path, capfd, ours):
    status, out, err = run(capfd, "--bag", ours)
    n = len(episode().record.command)
    assert status == 0 and f"shipped: {n} of {n} commands as recorded" in out
    assert "/points (sensor_msgs/msg/PointCloud2" in err
    status, out, _ = run(capfd, "--bag", ours, "--lidar-height", "1.2")
    assert status == 0 and f"shipped: {n} of {n}" not in out  # a lidar so high sees the floor elsewhere


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "name an .npz that `zebrat evaluate` wrote, or a recording: --bag FILE"),
        (["some.npz", "--bag", "some.mcap"], "name an .npz"),
        (["--bag", "none.mcap"], "none.mcap: no such file"),
        (["--bag", "none.mcap", "--tolerance", "-1", "0"], "a tolerance is"),
        (["--bag", "none.mcap", "--delay", "2"], "0 to 1 s after its scan"),
        (["--bag", "none.mcap", "--lidar-height", "nan"], "mounted 0 to 10 m high"),
        (["--bag", "none.mcap", "--agent", "nobody"], "no agent 'nobody'"),
    ],
)
def test_wrong_options_are_refused(arguments, said, capfd):
    status, _, err = run(capfd, *arguments)
    assert status == 2 and said in err
