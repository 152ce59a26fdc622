"""Success over each disturbance: the axes, a table that is gone on with and survives a kill, tables and figure."""

import json
import math
import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from zebrat_bullet.agents.policy import load_policy, save_policy
from zebrat_bullet.assets import find_asset
from zebrat_bullet.cli.main import main
from zebrat_bullet.config import DisturbanceConfig, DynamicsConfig, LidarConfig, TaskConfig
from zebrat_bullet.errors import AssetError, ConfigError, ZebratError
from zebrat_bullet.evaluation.axes import AXES, AXIS_NAMES, disturbed, everything_but, nominal_of, parse_axes
from zebrat_bullet.evaluation.claim import claim_folder
from zebrat_bullet.evaluation.csv_log import CsvLog
from zebrat_bullet.evaluation.robustness import COLUMNS, RobustnessRow, RobustnessStudy, read_table, run_study
from zebrat_bullet.evaluation.rollout import drive_episodes
from zebrat_bullet.notes import Note
from zebrat_bullet.report.robustness import draw_robustness, everything_table, robustness_table, summarise
from zebrat_bullet.robot import load_robot
from zebrat_bullet.types import Pose2
from zebrat_bullet.world import load_world
from zebrat_bullet.world.world import Mesh, Start

TASK = TaskConfig(lidar=LidarConfig(caster="embree"))
STUDY = RobustnessStudy(
    agents=("shipped",), axes={"mount_yaw": (0.0, 45.0)}, worlds=("real_1",), episodes=2, workers=1, task=TASK
)


def different(task: TaskConfig) -> dict[str, object]:
    """Return the ranges in which a task differs from the undisturbed one."""
    return {
        f"{part}.{name}": value
        for part in ("dynamics", "disturbance")
        for name, value in vars(getattr(task, part)).items()
        if value != getattr(getattr(TASK, part), name)
    }


@pytest.mark.parametrize("axis", AXIS_NAMES)
def test_an_axis_is_nothing_at_nominal_and_each_level_sets_what_it_is_about(axis: str) -> None:
    assert disturbed(TASK, axis, nominal_of(axis)) == TASK
    ((name, levels),) = parse_axes((axis,)).items()
    assert name == axis and list(levels) == sorted(levels) and nominal_of(axis) in levels and len(levels) == 5
    for level in levels:
        found = different(disturbed(TASK, axis, level))
        if axis != "everything":
            at = AXES[axis]
            assert set(found) <= {f"{at.part}.{at.setting}"} and len(found) == (level != at.nominal)


def test_levels_are_in_the_unit_of_their_axis() -> None:
    assert disturbed(TASK, "latency", 1.5).dynamics.delay_s == pytest.approx((0.3, 0.3))
    assert disturbed(TASK, "mount_yaw", -3.0).disturbance.mount_yaw_rad == pytest.approx((-math.pi / 60,) * 2)
    assert disturbed(TASK, "friction", 0.4).disturbance.friction == (0.4, 0.4)


def test_everything_within_a_fifth_is_worked_out_by_hand() -> None:
    task, degree = disturbed(TASK, "everything", 0.2), math.pi / 180
    around = {name: getattr(task.disturbance, name) for name in ("friction", "mass")}
    around |= {name: getattr(task.dynamics, name) for name in ("speed", "acceleration", "steering_rate")}
    assert all(between == pytest.approx((0.8, 1.2)) for between in around.values())
    assert task.dynamics.delay_s == pytest.approx((0.0, 0.08))
    assert task.dynamics.steering_offset_rad == pytest.approx((-1.2 * degree, 1.2 * degree))
    ranges = {
        "steering_lag_s": (0, 0.1), "command_noise": (0, 0.1), "range_sigma_m": (0, 0.01), "dropout": (0, 0.1),
        "dark_walls": (0, 0.04), "mount_offset_m": (0, 0.02), "mount_yaw_rad": (-degree, degree),
    }  # fmt: skip
    for name, between in ranges.items():
        assert getattr(task.disturbance, name) == pytest.approx(between), name
    drawn = [f"disturbance.{n}" for n in vars(DisturbanceConfig()) if not n.startswith("pose")]
    assert set(different(task)) == {*drawn, *(f"dynamics.{name}" for name in vars(DynamicsConfig()))}


def test_everything_but_some_of_it_draws_the_rest_alike() -> None:
    axis = everything_but(["dark_walls", "speed"])
    found, whole = (different(disturbed(TASK, name, 0.2)) for name in (axis, "everything"))
    assert found == {k: v for k, v in whole.items() if k not in ("disturbance.dark_walls", "dynamics.speed")}
    assert disturbed(TASK, axis, 0.0) == TASK and nominal_of(axis) == 0.0
    table = everything_table(summarise([row(axis, 0.2, 9)]))
    assert "| a | ±20% but dark_walls,speed | all | 9 of 10 |" in table
    with pytest.raises(ConfigError, match="no axis 'grip'"):
        everything_but(["grip"])


@pytest.mark.parametrize(
    ("axes", "said"),
    [
        ("grip", "no axis 'grip'; there are range_noise, dropout,"),
        ("mass=0.7,heavy", "levels are numbers, as in mass=0.7,0.85; got 'mass=0.7,heavy'"),
    ],
)
def test_axes_that_there_are_not_are_refused(axes: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        parse_axes((axes,))
    assert parse_axes(("mass=1.3,0.7", "dropout=0.5")) == {"mass": (0.7, 1.0, 1.3), "dropout": (0.0, 0.5)}


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"axes": {"mass": (-1.0,)}}, "disturbance.mass must be within"),
        ({"axes": {"latency": (3.0,)}}, "delay_s may be two control steps"),
        ({"axes": {"everything": (1.0,)}}, "a level of everything is from 0 up to 1, 1 not included, got 1"),
        ({"axes": {"dropout": (math.nan,)}}, "a level of dropout is a finite number"),
        ({"axes": {}}, "at least 1 agent, 1 axis"),
        ({"episodes": 0}, "at least 1 agent, 1 axis"),
        ({"supervised_m": -0.1}, "supervised_m must be 0 to 100"),
    ],
)
def test_a_study_of_what_cannot_be_is_refused(wrong: dict, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        replace(STUDY, **wrong)


def test_a_turned_lidar_is_the_end_of_shipped_and_what_is_there_is_not_driven_again(tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    rows = run_study(STUDY, tmp_path, lambda *at: told.append(at))
    assert [(at.axis, at.level, at.first, at.episodes, at.success) for at in rows] == [
        ("nominal", 0.0, 0, 2, 2), ("mount_yaw", 45.0, 0, 2, 0),
    ]  # fmt: skip
    table = tmp_path / "robustness.csv"
    whole = table.read_bytes()
    # A kill has left half a row and lost the last.
    lines = whole.splitlines(keepends=True)
    table.write_bytes(b"".join(lines[:-1]) + lines[-1][:9])
    told.clear()
    assert run_study(STUDY, tmp_path, lambda *at: told.append(at)) == rows and table.read_bytes() == whole
    assert [at[1:] for at in told] == [(2, 4), (4, 4)]
    # Fewer are there; of more, and of other axes, only what is not there is driven: nominal, for one, is.
    assert run_study(replace(STUDY, episodes=1), tmp_path) == rows
    more = run_study(replace(STUDY, episodes=3, axes={"friction": (1.0, 0.8)}), tmp_path)
    assert more[:2] == rows and {(at.axis, at.first, at.episodes) for at in more[2:]} == {
        ("nominal", 2, 1), ("friction", 0, 3),
    }  # fmt: skip
    with pytest.raises(ConfigError, match="holds episodes driven under another seed; name another --out"):
        run_study(replace(STUDY, seed=1), tmp_path)
    with pytest.raises(ConfigError, match="driven under another task"):
        run_study(replace(STUDY, settings=("episode.max_steps=300",)), tmp_path)


def test_a_run_folder_is_judged_and_a_supervised_driver_beside_the_bare_one(tmp_path: Path) -> None:
    run = tmp_path / "runs" / "bare"
    run.mkdir(parents=True)
    save_policy(load_policy("shipped"), run / "best.safetensors")
    study = replace(STUDY, agents=(str(run),), axes={"everything": (0.2,)}, episodes=1)
    run_study(study, tmp_path / "out")
    rows = run_study(replace(study, supervised_m=0.05), tmp_path / "out")
    assert [(at.axis, at.level, at.supervised, at.episodes) for at in rows] == [
        ("everything", 0.2, "", 1), ("everything", 0.2, "0.05", 1),
    ]  # fmt: skip
    assert list(summarise(rows)["everything"]) == ["bare", "bare, supervised"]


def test_runs_that_are_called_alike_are_told_apart() -> None:
    rows = [replace(row("everything", 0.2, 9), agent=f"runs/{at}/best.safetensors") for at in "ab"]
    assert list(summarise(rows)["everything"]) == ["runs/a/best.safetensors", "runs/b/best.safetensors"]


def test_a_planner_that_finds_no_plan_from_where_it_believes_to_be_stands(tmp_path: Path) -> None:
    lost = replace(TASK, disturbance=DisturbanceConfig(pose_sigma_m=1.0))
    # Twice it believes to stand in a wall.
    with pytest.warns(Note, match="dwa stands where an episode begins without a plan.*no place the"):
        record = next(drive_episodes("dwa", lost, load_world("real_1"), 0, [1]))
    assert record.outcome == "stall" and not record.command.any()
    study = replace(STUDY, agents=("dwa",), axes={"mass": (1.0,)}, task=lost)
    assert [(at.episodes, at.stall) for at in run_study(study, tmp_path)] == [(2, 2)]


def test_an_agent_that_there_is_not_is_told_before_anything_is_driven(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="no agent 'nobody'"):
        run_study(replace(STUDY, agents=("shipped", "nobody")), tmp_path)
    assert not list(tmp_path.iterdir())


def row(axis: str, level: float, success: int, **more: object) -> RobustnessRow:
    values = {"agent": "a", "weights": "", "supervised": "", "world": "w", "first": 0, "episodes": 10} | more
    left = int(str(values["episodes"])) - success
    return RobustnessRow(
        axis=axis, level=level, success=success, collision=left, false_exit=0, timeout=0, stall=0, **values
    )  # type: ignore[arg-type]


def test_episodes_that_two_runs_drove_at_once_count_once(tmp_path: Path) -> None:
    log = CsvLog(tmp_path / "robustness.csv", COLUMNS)
    rows = [row("mass", 1.3, 5), row("mass", 1.3, 4, first=10), row("mass", 1.3, 3, first=15), row("mass", 0.7, 3)]
    for each in rows:
        log.append(asdict(each))
    assert read_table(tmp_path) == [rows[0], rows[1], rows[3]]


def test_all_axes_share_the_undisturbed_episodes_and_worlds_are_pooled() -> None:
    rows = [row("nominal", 0.0, 10), row("nominal", 0.0, 8, world="v"), row("mass", 1.3, 5), row("mass", 0.7, 9)]
    rows += [row("mass", 1.3, 10, first=10), row("latency", 2.0, 0)]
    summary = summarise(rows)
    assert [(at["level"], at["episodes"], at["rate"]) for at in summary["mass"]["a"]] == [
        (0.7, 10, 0.9), (1.0, 20, 0.9), (1.3, 20, 0.75),
    ]  # fmt: skip
    # Wilson at 15 of 20: 0.531 to 0.888.
    assert (summary["mass"]["a"][2]["low"], summary["mass"]["a"][2]["high"]) == pytest.approx((0.531, 0.888), abs=1e-3)
    assert summary["mass"]["a"][1]["worlds"]["v"]["rate"] == 0.8
    assert [at["level"] for at in summary["latency"]["a"]] == [0.0, 2.0] and "friction" not in summary


def test_tables_and_figure_show_agents_side_by_side(tmp_path: Path) -> None:
    rows = [
        row("nominal", 0.0, 10),
        row("mass", 1.3, 5),
        row("everything", 0.2, 9),
        row("everything", 0.2, 4, world="v"),
    ]
    rows += [replace(each, agent="runs/b", supervised="0.05") for each in rows]
    summary = summarise(rows)
    table = robustness_table(summary)
    assert "| axis | level | a | b, supervised |" in table
    assert "| mass, factor | 1 (nominal) | 100% (72%-100%) | 100% (72%-100%) |" in table
    assert "| mass, factor | 1.3 | 50% (24%-76%), 5 contacts | 50% (24%-76%), 5 contacts |" in table
    together = everything_table(summary)
    assert "| a | ±20% | w | 9 of 10 | 59.6%-98.2% | 1 | - |" in together
    assert "| b, supervised | ±20% | all | 13 of 20 | 43.3%-81.9% | 7 | - |" in together
    draw_robustness(summary, tmp_path / "figure.svg")
    text = (tmp_path / "figure.svg").read_text(encoding="utf-8")
    assert text.count('id="axes_') == 2
    assert json.loads(json.dumps(summary)) == summary


def test_a_folder_from_before_a_setting_came_is_gone_on_with(tmp_path: Path) -> None:
    claim_folder(tmp_path, "rows", TASK, seed=0)
    path = tmp_path / "study.json"
    then = json.loads(path.read_text(encoding="utf-8"))
    del then["task"]["disturbance"]
    path.write_text(json.dumps(then), encoding="utf-8")
    claim_folder(tmp_path, "rows", TASK, seed=0)
    with pytest.raises(ConfigError, match="another task"):
        claim_folder(tmp_path, "rows", disturbed(TASK, "mass", 1.2), seed=0)
    path.write_text("[]", encoding="utf-8")
    with pytest.raises(ConfigError, match="holds no settings of a study"):
        claim_folder(tmp_path, "rows", TASK, seed=0)


def test_an_own_driver_or_world_that_was_edited_is_another(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        """
from zebrat_bullet.types import Command


class Stands:
    name, privileged = "stands", frozenset()

    def __init__(self, task): ...

    def reset(self, seed): ...

    def act(self, reading):
        return Command(0.0, 0.0)
""",
        encoding="utf-8",
    )
    place = tmp_path / "place.yaml"
    place.write_text(find_asset("worlds", "real_1", ".yaml").read_text(encoding="utf-8"), encoding="utf-8")
    agent = f"{tmp_path / 'mine.py'}:Stands"
    study = replace(STUDY, agents=(agent,), axes={"mass": (1.0,)}, worlds=(str(place),), episodes=1)
    assert [row.stall for row in run_study(study, tmp_path / "out")] == [1]
    with (tmp_path / "mine.py").open("a") as file:
        file.write("# the same, edited\n")
    rows = run_study(study, tmp_path / "out")
    assert len(rows) == 2 and len({row.weights for row in rows}) == 2 and all(len(row.weights) == 8 for row in rows)
    place.write_text(
        place.read_text(encoding="utf-8").replace("straight: 4.4, width: 1.4", "straight: 4.4, width: 1.5"),
        encoding="utf-8",
    )
    with pytest.raises(ConfigError, match=r"another .*place\.yaml; name another --out"):
        run_study(study, tmp_path / "out")
    study_file = tmp_path / "out" / "study.json"
    then = json.loads(study_file.read_text(encoding="utf-8"))
    study_file.write_text(json.dumps(then | {"car": "of before", "worlds": {}}), encoding="utf-8")
    with pytest.raises(ConfigError, match="another car; name another --out"):
        run_study(study, tmp_path / "out")


@pytest.mark.parametrize(
    "change",
    [
        {"gates": np.ones((1, 2, 2))},
        {"waypoints": np.ones((1, 2))},
        {"max_steps": 7},
        {"mesh": Mesh(np.ones((3, 3)), np.zeros((1, 3), np.int32))},
        {"start": Start(Pose2(0.0, 0.0, 0.1))},
    ],
    ids=lambda change: next(iter(change)),
)
def test_whatever_of_a_world_decides_an_episode_tells_it_from_another(change: dict, tmp_path: Path) -> None:
    world = load_world("real_1")
    claim_folder(tmp_path, "episodes", TASK, {"real_1": world}, seed=0)
    claim_folder(tmp_path, "episodes", TASK, {"real_1": world, "real_2": load_world("real_2")}, seed=0)
    with pytest.raises(ConfigError, match="another real_1; name another --out"):
        claim_folder(tmp_path, "episodes", TASK, {"real_1": replace(world, **change)}, seed=0)


@pytest.mark.parametrize("change", ["lidar_rpy", "knuckle_limit_rad", "yaw_inertia_kgm2", "footprint_base"])
def test_whatever_of_a_car_moves_it_tells_it_from_another(change: str, tmp_path: Path, monkeypatch) -> None:
    claim_folder(tmp_path, "episodes", TASK, seed=0)
    robot = load_robot("zebrat")
    other = replace(robot, **{change: getattr(robot, change) + 0.01})
    monkeypatch.setattr("zebrat_bullet.evaluation.claim.load_robot", lambda name: other)
    with pytest.raises(ConfigError, match="another car; name another --out"):
        claim_folder(tmp_path, "episodes", TASK, seed=0)


def test_how_near_to_the_floor_its_body_reaches_tells_no_car_from_another(tmp_path: Path, monkeypatch) -> None:
    claim_folder(tmp_path, "episodes", TASK, seed=0)
    other = replace(load_robot("zebrat"), body_bottom_m=0.01)
    monkeypatch.setattr("zebrat_bullet.evaluation.claim.load_robot", lambda name: other)
    claim_folder(tmp_path, "episodes", TASK, seed=0)


def test_a_damaged_table_is_refused_with_the_row(tmp_path: Path) -> None:
    log = CsvLog(tmp_path / "robustness.csv", COLUMNS)
    log.append(asdict(row("mass", 1.0, 1)))
    path = tmp_path / "robustness.csv"
    path.write_text(path.read_text(encoding="utf-8").replace(",1.0,", ",x,"), encoding="utf-8")
    with pytest.raises(ZebratError, match=r"robustness\.csv: holds a row of another kind, a,,,w,mass,x,"):
        read_table(tmp_path)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--axes", "mass", "--everything"], "--axes and --everything both say what is disturbed; give one"),
        (["--but", "mass"], "--but leaves something out of --everything; give that too"),
        (["--axes", "grip"], "no axis 'grip'; there are range_noise"),
        (["--everything", "1.5"], "a level of everything is from 0 up to 1"),
        (["--set", "seed=3"], "--set takes settings as task.KEY=VALUE, got seed=3"),
        (["--set", "task.disturbance.mass=[2,1]"], r"disturbance.mass must be \[least, greatest\]"),
        (["--pose-sigma-m", "-1"], "disturbance.pose_sigma_m must be within 0 to 100, got -1.0"),
        (["--episodes", "0"], "at least 1"),
        (["--axes", "friction=1"], "nothing is disturbed: friction is nominal at 1; .*, as in --axes friction="),
        (["--axes", "friction=1", "latency=0"], "friction is nominal at 1, latency is nominal at 0"),
        (["--everything", "0"], "everything is nominal at 0; .*, as in --everything 0.1"),
    ],
)
def test_a_users_mistake_is_told_in_one_line(
    options: list[str], said: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["robustness", "--agent", "shipped", "--out", str(tmp_path / "out"), "--quiet", *options]) == 2
    told = [line for line in capfd.readouterr().err.splitlines() if line.startswith("zebrat")]
    assert len(told) == 1 and re.search(said, told[0])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--agent", "nobody"], "no agent 'nobody'"),
        (["--agent", "shipped", "--worlds", "nowhere"], "nowhere"),
    ],
)
def test_an_unknown_agent_or_world_is_all_that_is_told(
    options: list[str], said: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["robustness", *options, "--axes", "mass=1.3", "--episodes", "1", "--out", str(tmp_path / "out")]) == 2
    told = capfd.readouterr().err
    assert said in told and told.startswith("zebrat robustness: ")  # and no progress bar before
    assert not list(tmp_path.iterdir())


def test_the_command_writes_table_figure_and_rows(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    options = ["--axes", "mass=1.3", "--worlds", "real_1", "--episodes", "1", "--caster", "embree", "--workers", "1"]
    assert main(["robustness", "--agent", "shipped", *options, "--out", str(tmp_path), "--json", "--quiet"]) == 0
    answer = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert [at["level"] for at in answer["mass"]["shipped"]] == [1.0, 1.3]
    names = {"robustness.csv", "robustness.json", "robustness.md", "robustness.png", "study.json"}
    assert {path.name for path in tmp_path.iterdir()} == names
    # The pose that planners get errs by 5 cm and 3 degrees, unless it is said otherwise.
    study = json.loads((tmp_path / "study.json").read_text(encoding="utf-8"))
    assert study["task"]["disturbance"]["pose_sigma_m"] == 0.05
    assert study["task"]["disturbance"]["pose_sigma_rad"] == pytest.approx(math.radians(3.0))
