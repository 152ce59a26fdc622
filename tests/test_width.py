"""Success over the width of a passage: the passages, what a car's geometry allows, and a table that survives a kill."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from own_cars import OwnCar

from zebrat_bullet.config import LidarConfig, PhysicsConfig, TaskConfig
from zebrat_bullet.errors import ConfigError, PolicyError, WorldError
from zebrat_bullet.evaluation.certified_width import CertifiedRow, bracket, certify_widths, read_certified
from zebrat_bullet.evaluation.csv_log import CsvLog
from zebrat_bullet.evaluation.metrics import tracks_interval, wilson_interval
from zebrat_bullet.evaluation.swept_width import one_sweep_width_m, rigid_width_m
from zebrat_bullet.evaluation.width import WidthRow, WidthStudy, mastered_m, run_study, width_range
from zebrat_bullet.geometry import footprint_hits
from zebrat_bullet.report.width import draw_width, summarise, width_table
from zebrat_bullet.robot import load_robot, most_steering_rad
from zebrat_bullet.task.episode import start_pose
from zebrat_bullet.world.passage import SHAPES, passage, senses

ROBOT = load_robot("zebrat")
TASK = TaskConfig(lidar=LidarConfig(caster="embree"))
STUDY = WidthStudy(agents=("shipped",), shapes=("90",), widths_m=(0.9, 1.3), episodes=4, task=TASK)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_passage_is_as_wide_everywhere_and_turns_as_it_says(shape: str) -> None:
    for sense in senses(shape):
        world = passage(shape, 1.05, sense)
        side = 1 if sense == "left" else -1
        assert (world.widths_m == 1.05).all()
        assert sum(world.turns_deg) == (0 if shape == "straight" else side * float(shape))


def test_the_two_senses_are_mirror_images() -> None:
    left, right = passage("180", 1.0, "left"), passage("180", 1.0, "right")
    assert np.allclose(left.centre_line * (1, -1), right.centre_line, atol=1e-9)
    # Round a wall 0.1 m thick the two legs lie 1.1 m apart.
    assert left.centre_line[-1, 1] == pytest.approx(1.1)


@pytest.mark.parametrize("width_m", [0.65, 0.8, 1.6])
def test_no_start_pose_touches_a_wall_however_narrow_the_passage(width_m: float) -> None:
    world = passage("straight", width_m)
    rng = np.random.default_rng(0)
    assert not any(footprint_hits(world.walls, ROBOT.footprint_base, start_pose(world, rng)) for _ in range(200))


def test_where_there_is_room_the_start_range_is_the_usual_one() -> None:
    wide, narrow = (passage("90", width).start for width in (1.0, 0.8))
    assert (wide.range_y_m, wide.range_yaw_rad) == (0.1, 0.15)
    assert 0.0 < narrow.range_y_m < 0.1 and narrow.range_yaw_rad / narrow.range_y_m == pytest.approx(1.5)


def test_a_car_too_long_for_the_passages_is_told_so_and_its_folder_stays_free(tmp_path: Path) -> None:
    long = '<collision><origin xyz="0 0 0.12"/><geometry><box size="2.2 0.30 0.12"/></geometry></collision>'
    task = replace(TASK, robot=str(OwnCar(collision=long).write(tmp_path)))
    study = replace(STUDY, agents=("random",), task=task)
    with pytest.raises(ConfigError, match=r"own\.urdf, 2\.20 m long, .* has no room to begin in the passages"):
        run_study(study, tmp_path / "out")
    with pytest.raises(WorldError, match="make it wider than"):
        run_study(replace(study, widths_m=(0.3, 0.9)), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_passage_narrower_than_the_car_or_of_no_known_shape_is_refused() -> None:
    with pytest.raises(WorldError, match="make it wider than"):
        passage("straight", 0.55)
    with pytest.raises(
        ConfigError, match=r"no passage 'straight' with the sense 'right'; there are straight \(left\), 45"
    ):
        passage("straight", 1.0, "right")


def test_least_widths_of_zebrat_are_those_worked_out_by_hand() -> None:
    # 1.0 m x 0.6 m: (0.6 + 0.5) / sqrt(2) at a right angle. The sweeps: DESIGN's 1.359, 1.142 and 0.519 m.
    assert rigid_width_m("90", ROBOT) == pytest.approx(1.1 / np.sqrt(2))
    assert [one_sweep_width_m(shape, ROBOT, PhysicsConfig()) for shape in ("straight", "90")] == [0.6, 0.9]
    assert 2 * one_sweep_width_m("180", ROBOT, PhysicsConfig()) + 0.1 == pytest.approx(2.5, abs=0.003)


def test_a_car_that_steers_less_than_the_task_sweeps_by_its_own_limit() -> None:
    stiff = replace(ROBOT, knuckle_limit_rad=0.3)
    itself = one_sweep_width_m("180", stiff, PhysicsConfig(max_steering_rad=most_steering_rad(stiff)))
    assert one_sweep_width_m("180", stiff, PhysicsConfig()) == itself > one_sweep_width_m("180", ROBOT, PhysicsConfig())
    assert one_sweep_width_m("180", replace(ROBOT, knuckle_limit_rad=0.02), PhysicsConfig()) is None


def test_no_rectangle_is_seen_in_a_hexagon() -> None:
    assert rigid_width_m("90", load_robot("hexagon")) is None


def row(width_m: float, success: int, sense: str = "left") -> WidthRow:
    return WidthRow(
        agent="a", sim="planar", weights="", shape="90", sense=sense, width_m=width_m,
        episodes=100, success=success, collision=100 - success, false_exit=0, timeout=0, stall=0,
    )  # fmt: skip


def test_a_width_is_mastered_only_where_every_wider_one_is_too() -> None:
    assert mastered_m([row(1.0, 99), row(1.1, 94), row(1.2, 95), row(1.3, 100)]) == 1.2
    assert mastered_m([row(1.0, 100), row(1.1, 90), row(1.1, 100, "right")]) == 1.0
    assert mastered_m([row(1.0, 100), row(1.1, 89), row(1.1, 100, "right")]) is None


def test_widths_go_from_least_to_most_both_included() -> None:
    assert width_range(0.8, 1.6, 0.025)[::16] == (0.8, 1.2, 1.6) and len(width_range(0.8, 1.6, 0.025)) == 33
    with pytest.raises(ConfigError, match="0 < least <= most"):
        width_range(1.2, 1.0, 0.1)


def test_a_policy_masters_a_wide_corner_and_fails_in_a_narrow_one_and_rows_are_not_driven_again(tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    rows = run_study(STUDY, tmp_path, lambda *at: told.append(at))
    assert {(at.sense, at.width_m): at.success for at in rows} == {
        ("left", 0.9): 0, ("right", 0.9): 0, ("left", 1.3): 4, ("right", 1.3): 4,
    }  # fmt: skip
    table = tmp_path / "width.csv"
    whole = table.read_bytes()
    # A kill has left half a row and lost the last.
    lines = whole.splitlines(keepends=True)
    table.write_bytes(b"".join(lines[:-1]) + lines[-1][:9])
    told.clear()
    assert run_study(STUDY, tmp_path, lambda *at: told.append(at)) == rows
    assert [at[1:] for at in told] == [(2, 2), (1, 2), (2, 2)]
    assert table.read_bytes() == whole
    # Fewer episodes are there already, more are not; another seed is another study.
    assert run_study(replace(STUDY, episodes=2), tmp_path) == rows
    assert {at.episodes for at in run_study(replace(STUDY, episodes=5), tmp_path)} == {5}
    with pytest.raises(ConfigError, match="another seed; name another --out"):
        run_study(replace(STUDY, seed=1), tmp_path)


def test_an_agent_that_is_no_policy_drives_in_bullet(tmp_path: Path) -> None:
    study = replace(STUDY, agents=("random",), widths_m=(1.3,), episodes=1, workers=1)
    rows = run_study(study, tmp_path)
    assert [(at.sim, at.episodes, at.success, at.weights) for at in rows] == [("bullet", 1, 0, "")] * 2


def test_the_least_certified_width_is_narrowed_down_and_gone_on_with(tmp_path: Path) -> None:
    widths = (0.7, 0.8, 1.2, 1.4, 1.6)
    rows = certify_widths(("90",), widths, TASK, tmp_path, 1)
    assert bracket(rows, "90") == (0.8, 1.2)
    assert {at.width_m: at.certified for at in rows} == {1.2: 1, 0.8: 0}
    before = (tmp_path / "certified.csv").read_bytes()
    assert certify_widths(("90",), widths, TASK, tmp_path, 1) == rows == read_certified(tmp_path)
    assert (tmp_path / "certified.csv").read_bytes() == before
    log = CsvLog(tmp_path / "certified.csv", ())
    assert len(log.rows()) == 2


def test_table_and_figure_show_agents_beside_the_bounds(tmp_path: Path) -> None:
    certified = [
        CertifiedRow(
            robot="zebrat", shape="90", width_m=w, certified=w > 0.9, proven=0, reversals=0, clearance_m=0.0, wall_s=0.0
        )
        for w in (0.9, 0.95)
    ]
    summary = summarise([row(1.0, 50), row(1.1, 97), row(1.2, 100)], certified, TASK)
    assert summary["agents"]["a planar"]["90"]["mastered_m"] == 1.1
    table = width_table(summary)
    assert (
        "| a drive is certified | - | - | 0.950 | - |" in table
        and "| a planar, 95% success | - | - | 1.100 | - |" in table
    )
    part = [replace(row(width, 100), agent="b") for width in (0.9, 1.0)]
    both = width_table(summarise([row(1.0, 50), row(1.2, 100), *part], certified, TASK))
    assert "| b planar, 95% success | - | - | at most 0.900 (driven to 1.000) | - |" in both
    draw_width(summary, tmp_path / "width.png")
    assert (tmp_path / "width.png").stat().st_size > 10_000


def test_runs_that_are_called_alike_and_other_simulators_are_rows_of_their_own() -> None:
    rows = [replace(row(1.0, n), agent=f"runs/{at}/best.safetensors") for at, n in (("a", 100), ("b", 0))]
    rows += [replace(row(1.0, n), agent="shipped", sim=sim) for sim, n in (("planar", 100), ("mujoco", 0))]
    agents = summarise(rows, [], TASK)["agents"]
    assert {label: at["90"]["mastered_m"] for label, at in agents.items()} == {
        "runs/a/best.safetensors planar": 1.0, "runs/b/best.safetensors planar": None,
        "shipped planar": 1.0, "shipped MuJoCo": None,
    }  # fmt: skip


def test_the_interval_over_tracks_is_wider_where_episodes_of_a_track_end_alike() -> None:
    alike, mixed = np.array([8] * 90 + [0] * 10), np.array([7] * 80 + [8] * 20)
    assert tracks_interval(alike, 8) == pytest.approx(wilson_interval(90, 100), abs=0.002)
    assert tracks_interval(mixed, 8) == pytest.approx(wilson_interval(720, 800), abs=0.002)
    assert tracks_interval(np.full(100, 8), 8) == wilson_interval(100, 100)
    assert tracks_interval(np.array([4]), 8) == wilson_interval(0.5, 1)


def test_planar_cars_are_refused_to_whoever_is_no_policy() -> None:
    from zebrat_bullet.evaluation.generated import judge_generated

    with pytest.raises(PolicyError, match="'random' is none; drive it in PyBullet"):
        judge_generated("random", [0], 1, TASK)
