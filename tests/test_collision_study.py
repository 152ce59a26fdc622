"""The study of representations: its truth, its counts worked out by hand, and what survives a crash."""

import csv
import json
import time
import warnings
from dataclasses import asdict, replace

import numpy as np
import pytest
import shapely
from boxes import box_world
from own_cars import OwnCar

from zebrat_bullet.config import LidarConfig, NoiseConfig, TaskConfig
from zebrat_bullet.detection import scoring, study, traces
from zebrat_bullet.detection.cases import Case, cases
from zebrat_bullet.detection.places import free_pose, load_place
from zebrat_bullet.detection.representations import Representation, fires, region_of
from zebrat_bullet.detection.scoring import Sensing, TraceScore, score_trace, take_readings
from zebrat_bullet.detection.study import Study, Tally, run_study
from zebrat_bullet.detection.summary import recommended_margins, relative_difference, summarise
from zebrat_bullet.detection.traces import DriveJob, Trace, footprint_distances, load_trace, record_drives, save_trace
from zebrat_bullet.errors import ConfigError, ZebratError
from zebrat_bullet.evaluation.npz import save_npz
from zebrat_bullet.evaluation.workers import worker_pool
from zebrat_bullet.report.collision_report import write_misses_mp4, write_report
from zebrat_bullet.robot import load_robot

BASE = [Representation(kind=kind, n_rays=0 if kind == "cloud" else 32) for kind in ("sr", "firect", "fifr", "cloud")]
WALL = box_world(((1.0, 1.1), (-3.0, 3.0), (0.0, 1.0)))


def job(**changes):
    given = {"world": "track_2", "driver": "random-smooth", "walls": "solid", "seed": 3, "chunk": 0, "n_drives": 4}
    return DriveJob(**given | changes, task=TaskConfig())


@pytest.fixture(scope="module")
def solid() -> Trace:
    return record_drives(job())


@pytest.fixture(scope="module")
def ghost() -> Trace:
    return record_drives(job(walls="ghost"))


def straight_trace(monkeypatch, x_m: np.ndarray) -> Trace:
    """One drive along the x axis towards a flat wall at x = 1, its centre at these places, 120 to a second."""
    robot, n = load_robot(), len(x_m)
    for module in (scoring, traces):
        monkeypatch.setattr(module, "load_place", lambda name, robot: WALL)
    pose = np.stack([x_m, np.zeros(n), np.zeros(n)], axis=1)
    return Trace(
        world="wall",
        driver="hand",
        walls="ghost",
        chunk=0,
        rate_hz=120.0,
        first_row=np.array([0, n]),
        pose=pose,
        tilt=np.zeros((n, 3)),
        speed_mps=np.full(n, 0.6),
        contact=np.zeros(n, bool),
        distance_m=footprint_distances(pose, robot, WALL),
    )


def test_a_drive_at_a_wall_is_scored_as_worked_out_by_hand(monkeypatch):
    # 0.6 m/s are 5 mm a row. The nose, 0.5 m ahead of the centre, meets the wall at x = 0.5: row 100 of the drive.
    trace = straight_trace(monkeypatch, 0.005 * np.arange(0, 181))
    readings = take_readings(trace, "zebrat", Sensing(), seed=0)
    assert list(readings.row[:6]) == [0, 24, 48, 72, 96, 120]
    made = score_trace(trace, readings, [*BASE, Representation(kind="sr", margin_m=0.05)], "zebrat")
    (event,) = made.events
    assert event.time_s == pytest.approx(100 / 120) and event.contact_x == pytest.approx(0.5)
    # SR and cloud see it in the first sweep that finds the nose in the wall, row 120, 20 rows late.
    # FIFR's circle of 0.3 m about the lidar at 0.4 reaches 0.2 m past the nose: from x = 0.3, row 60, so in row 72.
    # With a margin of 5 cm: from x = 0.45, row 90, so in row 96.
    assert made.lead_s[:, 0] == pytest.approx(np.array([-20, -20, 28, -20, 4]) / 120)
    assert made.in_time[:, 0].all() and not made.false_alarms.any() and made.clear_s == 0.0
    assert list(made.overlap_reports[:, 0]) == [3] * 5 and list(made.overlap_sweeps) == [3]


def test_sweeps_more_often_see_the_wall_sooner_and_an_odd_rate_is_refused(monkeypatch):
    trace = straight_trace(monkeypatch, 0.005 * np.arange(0, 181))
    readings = take_readings(trace, "zebrat", Sensing(rate_hz=20.0), seed=0)
    assert score_trace(trace, readings, BASE[:1], "zebrat").lead_s[0, 0] == pytest.approx(-2 / 120)
    with pytest.raises(ConfigError, match="do not fall on physics steps at 120 Hz"):
        take_readings(trace, "zebrat", Sensing(rate_hz=7.0), seed=0)


def test_reports_without_a_contact_are_false_alarms_and_count_once(monkeypatch):
    # Up to 0.1 m before the wall, back, and up to it again: FIFR fires in two runs of sweeps, the others in none.
    there = 0.3 + 0.1 * np.sin(np.linspace(0.0, 4.0 * np.pi, 480))
    made = score_trace(
        t := straight_trace(monkeypatch, there), take_readings(t, "zebrat", Sensing(), 0), BASE, "zebrat"
    )
    assert not made.events and made.lead_s.shape == (4, 0)
    assert list(made.false_alarms) == [0, 0, 2, 0] and made.clear_s == pytest.approx(4.0)


def test_solid_walls_stop_the_car_where_its_outline_meets_them(solid):
    assert solid.contact.any()
    assert solid.distance_m[solid.contact].max() < 2e-3
    world = load_place("track_2")
    deep = [
        shapely.intersection(
            shapely.Polygon(traces.to_world(load_robot().footprint_base, solid.state_at(row).pose)), world.walls
        ).area
        for row in np.flatnonzero(solid.contact)[::20]
    ]
    assert max(deep) < 2e-3  # a whole side 2 mm deep


def test_solid_and_ghost_drives_are_the_same_until_they_meet_a_wall(solid, ghost):
    for drive in range(4):
        a, b = (trace.first_row[drive] for trace in (solid, ghost))
        n = int(np.argmax(solid.hits[a : solid.first_row[drive + 1]])) or 50
        assert np.array_equal(solid.pose[a : a + n], ghost.pose[b : b + n])
    assert ghost.distance_m.min() == 0.0 and not ghost.contact.any()


def test_a_trace_is_the_same_again_and_survives_the_disk(solid, tmp_path):
    again = record_drives(job())
    assert np.array_equal(again.pose, solid.pose) and np.array_equal(again.contact, solid.contact)
    save_trace(solid, tmp_path / "trace.npz")
    read = load_trace(tmp_path / "trace.npz")
    assert np.array_equal(read.distance_m, solid.distance_m) and read.world == "track_2"
    whole = (tmp_path / "trace.npz").read_bytes()
    for damaged in (b"", b"cut short", whole[: len(whole) // 2], whole[:500] + bytes(500) + whole[1000:]):
        (tmp_path / "trace.npz").write_bytes(damaged)
        with pytest.raises(ZebratError, match="make it anew"):
            load_trace(tmp_path / "trace.npz")


def test_both_casters_and_repeated_noise_report_the_same(ghost):
    one, two = (
        take_readings(ghost, "zebrat", Sensing(lidar=LidarConfig(caster=name)), 0) for name in ("embree", "bullet")
    )
    differ = np.abs(one.scans - two.scans) > 1e-4
    assert differ.mean() < 1e-3  # rays that graze an edge
    noisy = Sensing(noise=NoiseConfig(range_sigma_m=0.02))
    first, second = (take_readings(ghost, "zebrat", noisy, 5) for _ in range(2))
    assert np.array_equal(first.scans, second.scans) and not np.array_equal(first.scans, one.scans)


def test_sr_and_firect_report_nothing_that_the_cloud_does_not_and_the_cloud_nothing_that_is_not_there(ghost):
    readings = take_readings(ghost, "zebrat", Sensing(), 0)
    sr, firect, _, cloud = (fires(what, "zebrat", readings.scans, readings.cloud_gaps_m) for what in BASE)
    assert cloud.any() and not (sr & ~cloud).any() and not (firect & ~cloud).any()
    assert not (cloud & ~(ghost.distance_m[readings.row] <= 0.0)).any()


def test_a_representation_has_the_rays_it_was_asked_for():
    for n in (8, 12, 24, 32, 48, 64, 180, 360):
        assert len(region_of(Representation(kind="sr", n_rays=n), "zebrat", 360).indices) == n
    for kind in ("sr", "firect", "fifr"):
        assert len(region_of(Representation(kind=kind, margin_m=0.05), "zebrat", 360).indices) == 32
    with pytest.raises(ConfigError, match="no representation 'lidar'; there are sr, firect, fifr, cloud"):
        Representation(kind="lidar")


def test_posts_stand_where_they_say_and_bad_names_are_refused():
    thin, thick = load_place("posts-0.02"), load_place("posts-0.2")
    assert len(thin.walls.geoms) == len(thick.walls.geoms) == 49
    assert thin.walls.geoms[0].centroid.distance(thick.walls.geoms[0].centroid) < 1e-6
    assert np.sqrt(4 / np.pi * thick.walls.geoms[0].area) == pytest.approx(0.2, rel=0.02)
    pose = free_pose(thin, load_robot(), np.random.default_rng(0))
    assert footprint_distances(np.array([[pose.x, pose.y, pose.yaw]]), load_robot(), thin)[0] > 0.1
    for name in ("posts-thin", "posts-9"):
        with pytest.raises(ConfigError, match=r"named like posts-0\.02"):
            load_place(name)


def tally(in_time: list[int], lead: float = -0.1, false_alarms: int = 0) -> Tally:
    seen = np.array(in_time, bool)
    return Tally(
        events=[None] * len(seen),
        lead_s=np.where(seen, lead, np.nan),
        in_time=seen,
        false_alarms=false_alarms,
        clear_s=120.0,
        overlap_sweeps=np.full(len(seen), 3),
        overlap_reports=3 * seen,
    )


def test_an_interval_that_few_contacts_do_not_give_is_nan_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        difference, *interval = relative_difference(tally([1, 1]), tally([1, 0]), "in_time")
    assert difference == 1.0 and np.isnan(interval).all()


def test_summaries_differences_and_the_recommended_margin_are_worked_out_by_hand():
    at = summarise(tally([1, 1, 1, 0], false_alarms=1))
    assert (at.contacts, at.in_time, at.recall, at.precision, at.clear_minutes) == (4, 3, 0.75, 0.75, 2.0)
    assert (at.overlap_reports, at.overlap_sweeps, at.lead_s) == (9, 12, pytest.approx(-0.1))
    many, fewer = tally([1] * 200), tally([1] * 160 + [0] * 40)
    difference, low, high = relative_difference(fewer, many, "in_time")
    assert difference == pytest.approx(-0.2) and -0.26 < low < -0.2 < high < -0.14
    assert all(np.isnan(relative_difference(fewer, tally([0] * 200), "in_time")))
    assert all(np.isnan(relative_difference(tally([1]), tally([1]), "in_time")))

    def case(margin: float) -> Case:
        what = Representation(kind="sr", margin_m=margin)
        return Case(panel="margin", setting=f"{margin:g}", sensing=Sensing(), representation=what)

    results = {("solid", case(0.0)): fewer, ("solid", case(0.02)): tally([1] * 200, false_alarms=3)}
    results[("solid", case(0.04))] = tally([1] * 200, false_alarms=9)
    assert recommended_margins(results, "solid")["sr"][0] == 0.02
    assert recommended_margins(results, "ghost") == {}


SMALL = Study(worlds=("track_2",), drivers=("random-smooth",), n_events=6, seed=1)


@pytest.mark.slow
def test_a_study_resumes_after_a_crash_with_the_same_counts_and_reports_them(tmp_path, monkeypatch):
    chosen = cases(["base", "rays"], Sensing(), 32, [0.0])
    said = []
    whole = run_study(SMALL, chosen, tmp_path / "whole", 2, lambda *at: said.append(at))
    kept = sorted((tmp_path / "whole" / "traces").glob("*.npz"))
    assert len(next(iter(whole.values())).events) >= 6 and said[-1][1] == said[-1][2]

    (tmp_path / "cut" / "traces").mkdir(parents=True)  # as if killed after the first file and within the second
    (tmp_path / "cut" / "traces" / kept[0].name).write_bytes(kept[0].read_bytes())
    (tmp_path / "cut" / "study.json").write_bytes((tmp_path / "whole" / "study.json").read_bytes())
    (tmp_path / "cut" / "traces" / kept[-1].name).with_suffix(".part").write_bytes(b"half")
    before = (tmp_path / "cut" / "traces" / kept[0].name).stat().st_mtime_ns
    again = run_study(SMALL, chosen, tmp_path / "cut", 1, lambda *at: None)
    assert (tmp_path / "cut" / "traces" / kept[0].name).stat().st_mtime_ns == before
    assert {at: summarise(one) for at, one in again.items()} == {at: summarise(one) for at, one in whole.items()}

    monkeypatch.setattr(study, "take_readings", None)  # all is scored: nothing needs to be swept again
    run_study(SMALL, chosen, tmp_path / "whole", 1, lambda *at: None)
    with pytest.raises(ConfigError, match="other settings"):
        run_study(replace(SMALL, seed=2), chosen, tmp_path / "whole", 1, lambda *at: None)

    text = write_report(SMALL, whole, {}, tmp_path / "whole")
    assert "solid walls" in text and "| FIRect | 407 (-19.9%) |" in text
    rows = list(csv.DictReader((tmp_path / "whole" / "events.csv").open()))
    n_in_time = sum(int(row["sr_in_time"]) for row in rows if row["walls"] == "ghost")
    assert n_in_time == next(t for (w, c), t in whole.items() if (w, c.panel) == ("ghost", "base")).in_time.sum()
    for name in ("cases.csv", "counts.png", "misses.png", "sweeps.png"):
        assert (tmp_path / "whole" / name).stat().st_size > 1000
    film = write_misses_mp4(SMALL, whole, tmp_path / "whole", tmp_path / "film")
    assert film is not None and film.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"n_events": 0}, "at least 1"),
        ({"worlds": ()}, "at least one world"),
        ({"drivers": ("drunk",)}, "no driver 'drunk'; there are random, random-smooth, policy"),
        ({"walls": ("soft",)}, "walls are solid or ghost"),
        ({"worlds": ("nowhere",)}, "nowhere"),
        ({"worlds": ("track_2", "mine/track_2.yaml")}, "must differ"),
        ({"drivers": ("random", "random")}, "must differ"),
        ({"drivers": ("policy",), "policy": "nobody"}, "no agent 'nobody'"),
        ({"drivers": ("policy",), "policy": "oracle"}, "has its scan alone, oracle needs goal, map, pose"),
        ({"task": TaskConfig(robot="tank")}, "no urdf named 'tank'"),
    ],
)
def test_a_bad_study_is_refused_before_anything_is_driven(tmp_path, changes, said):
    with pytest.raises(ZebratError, match=said):
        run_study(replace(SMALL, **changes), cases(["base"], Sensing(), 32, [0.0]), tmp_path, 1, lambda *at: None)
    assert not list(tmp_path.rglob("study.json"))


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ((["colour"], Sensing(), 32, [0.0]), "no panel colour; there are base, margin"),
        ((["base"], Sensing(), 32, []), "at least one margin"),
        ((["base"], Sensing(), 32, [-0.01]), "margin_m must be at least 0, got -0.01"),
        ((["base"], Sensing(), 0, [0.0]), "n_rays is 0 for the cloud and above 0 otherwise, got 0 for sr"),
        ((["base"], Sensing(rate_hz=0.0), 32, [0.0]), "do not fall on physics steps"),
    ],
)
def test_bad_cases_are_refused_before_anything_is_driven(tmp_path, asked, said):
    with pytest.raises(ConfigError, match=said):
        run_study(SMALL, cases(*asked), tmp_path, 1, lambda *at: None)
    assert not list(tmp_path.iterdir())


def test_a_folder_without_drives_is_free_for_another_study_and_one_with_drives_is_not(tmp_path):
    study._claim(tmp_path, SMALL, {})
    other = replace(SMALL, seed=2)
    study._claim(tmp_path, other, {})
    (tmp_path / "traces" / "solid-track_2-random-smooth-000.npz").touch()
    study._claim(tmp_path, replace(other, n_events=7, walls=("solid",)), {})
    (tmp_path / "study.json").write_text("{", encoding="utf-8")
    with pytest.raises(ConfigError, match="readable as JSON"):
        study._claim(tmp_path, other, {})


def test_drives_of_a_car_world_or_policy_whose_file_has_changed_since_are_refused(tmp_path):
    car, world, driver = tmp_path / "car.urdf", tmp_path / "u.yaml", tmp_path / "mine.py"
    car.write_text(OwnCar().urdf(), encoding="utf-8")
    world.write_text("{name: u, segments: [{straight: 4, width: 1.2}]}", encoding="utf-8")
    driver.write_text(
        "from zebrat_bullet.agents.agent import RandomAgent\ndef mine(task): return RandomAgent(0.6, 0.5)"
    )
    what = Study(
        worlds=(str(world),), drivers=("policy",), walls=("solid",), n_events=1, policy=f"{driver}:mine",
        task=TaskConfig(robot=str(car)),
    )  # fmt: skip
    out = tmp_path / "out"
    traces = study.drive(what, out, 1, lambda *at: None)
    assert study.drive(what, out, 1, lambda *at: None) == traces
    for file, was, now in (
        (car, 'xyz="0.1 0 0.25"', 'xyz="0.1 0 0.26"'),
        (world, "1.2", "1.3"),
        (driver, "0.5", "0.4"),
    ):
        text = file.read_text(encoding="utf-8")
        assert was in text
        file.write_text(text.replace(was, now, 1), encoding="utf-8")
        with pytest.raises(ConfigError, match="before the file of the car, a world or the policy changed"):
            study.drive(what, out, 1, lambda *at: None)
        file.write_text(text, encoding="utf-8")
    kept = json.loads((out / "study.json").read_text(encoding="utf-8"))
    older = {key: value for key, value in kept.items() if key != "files"}
    (out / "study.json").write_text(json.dumps(older), encoding="utf-8")  # as earlier versions wrote it
    assert study.drive(what, out, 1, lambda *at: None) == traces
    assert json.loads((out / "study.json").read_text(encoding="utf-8")) == kept


def test_after_an_error_the_jobs_that_have_not_begun_are_dropped():
    with pytest.raises(ZeroDivisionError), worker_pool(1, 50) as pool:
        jobs = [pool.submit(time.sleep, 0.1) for _ in range(50)]
        raise ZeroDivisionError
    assert sum(job.cancelled() for job in jobs) > 40
    with pytest.raises(ConfigError, match="workers must be at least 1, got 0"), worker_pool(0, 1):
        pass


def test_scores_survive_the_disk(tmp_path, solid):
    readings = take_readings(solid, "zebrat", Sensing(), 0)
    made = score_trace(solid, readings, BASE, "zebrat")
    save_npz(tmp_path / "score.npz", study.SCORE_SCHEMA, asdict(made))
    read = study._load_score(tmp_path / "score.npz")
    assert isinstance(read, TraceScore) and read.events == made.events and read.clear_s == made.clear_s
    assert np.array_equal(read.lead_s, made.lead_s, equal_nan=True)
    (tmp_path / "score.npz").write_bytes(b"")
    with pytest.raises(ZebratError, match="make it anew"):
        study._load_score(tmp_path / "score.npz")
