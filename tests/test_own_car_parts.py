"""What hangs on a car's wheels and hinges counts, in the unit it is written in; what is misread is refused by name."""

from pathlib import Path

import pytest
from own_cars import OwnCar

from zebrat_bullet.errors import RobotError
from zebrat_bullet.robot import load_robot, named_robot

WHEELS = ("left_rear", "right_rear", "left_front", "right_front")
INERTIA = '<inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/>'


def fixed(name: str, parent: str, inside: str = "", origin: str = "") -> str:
    """Return a link fixed to another."""
    return (
        f'<link name="{name}">{inside}</link><joint name="{name}_joint" type="fixed"><parent link="{parent}"/>'
        f'<child link="{name}"/>{origin}</joint>'
    )


def limits(lower: float, upper: float) -> str:
    return f'<limit lower="{lower}" upper="{upper}" effort="5" velocity="6"/>'


def test_steering_limits_in_degrees_are_refused_with_their_radians(tmp_path: Path) -> None:
    path = OwnCar(hinge_limit=limits(-30, 30)).write(tmp_path)
    with pytest.raises(RobotError, match=r"from -30 to 30 rad.*if degrees are meant, write -0\.5236 to 0\.5236"):
        load_robot(path)
    with pytest.raises(RobotError, match=r"got '30' rad; if degrees are meant, write 0\.5236"):
        named_robot(path, ["steering_limit_rad=30"])
    assert load_robot(named_robot(path, ["steering_limit_rad=0.5"])).knuckle_limit_rad == 0.5


@pytest.mark.parametrize(
    ("lower", "upper", "taken", "said"),
    [
        (-0.2, 0.6, 0.2, r"left_steering_hinge_joint turns from -0.2 to 0.6 rad; 0.2 to both sides is taken"),
        (-1.57, 1.57, 1.4, r"the hinges may turn by 1.57 rad; 1.4 rad is taken, the most there is"),
    ],
)
def test_a_steering_limit_that_is_not_taken_as_written_is_said(
    tmp_path: Path, lower: float, upper: float, taken: float, said: str
) -> None:
    robot = load_robot(OwnCar(hinge_limit=limits(lower, upper)).write(tmp_path))
    assert robot.knuckle_limit_rad == taken and said in robot.notes
    assert not any("hinge" in note for note in load_robot(OwnCar().write(tmp_path)).notes)


def test_a_fault_in_the_roles_file_is_told_of_that_file_with_the_nearest_name(tmp_path: Path) -> None:
    path = OwnCar().write(tmp_path)
    (tmp_path / "own.roles.yaml").write_text("wheel_radius: 0.05\n")
    with pytest.raises(RobotError, match=r"own\.roles\.yaml: .*'wheel_radius' \(did you mean wheel_radius_m\?\)"):
        load_robot(path)
