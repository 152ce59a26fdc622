"""What a user says of a URDF: which of its joints has which role, and numbers that it leaves out."""

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zebrat_bullet.assets import asset_folder, find_asset
from zebrat_bullet.config import FOOTPRINTS
from zebrat_bullet.errors import RobotError
from zebrat_bullet.files import is_file, read_yaml, shown
from zebrat_bullet.robot.model import ROLES

NUMBERS = {
    "steering_limit_rad": "largest angle of the steering hinges",
    "hinge_effort_nm": "torque of each steering hinge",
    "hinge_speed_radps": "speed of the steering hinges",
    "wheel_effort_nm": "torque of each wheel",
    "wheel_speed_radps": "speed of the wheels",
    "wheel_radius_m": "radius of all wheels",
    "body_mass_kg": "mass of all but wheels and knuckles",
}
ONCE_ROUND_RAD = 6.3
"""No hinge turns further; what is beyond was written in degrees."""
XACRO = "xacro."
"""Before the name of a xacro argument."""
_SETTINGS = re.compile(r"^(?P<file>.*?):(?P<settings>[\w.]+=.*)$", re.DOTALL)


@dataclass(frozen=True, kw_only=True)
class RobotSetup:
    """A URDF and what is said of it.

    Attributes:
        path: the file.
        source: what names this setup from any folder.
        roles: joint of each role (for the lidar: joint or link); a role that is not said is the joint of its own name.
        footprint: "collision": the outline of the collision shapes; "hull": of all shapes; "auto": of the collision
            shapes, or of all that stands outside of them too, where wheels, lidar or bodies without collision shape do.
        numbers: of `NUMBERS`; they go before what the URDF says.
        xacro: arguments of a xacro file.
    """

    path: Path
    source: str
    roles: Mapping[str, str]
    footprint: str = "auto"
    numbers: Mapping[str, float] = field(default_factory=dict)
    xacro: Mapping[str, str] = field(default_factory=dict)


def named_robot(name_or_path: str | Path, settings: Sequence[str] = ()) -> str:
    """Return the name of a car with further settings ("key=value"), readable from any folder.

    Raises:
        AssetError: there is no such URDF.
        RobotError: a setting is none; the message lists those there are.
    """
    return robot_setup(",".join([_joined(str(name_or_path)), *settings]) if settings else name_or_path).source


def _joined(name: str) -> str:
    """Return a name to which ",key=value" can be added."""
    file, given = _split(name)
    return f"{file}:{','.join(f'{key}={value}' for key, value in given.items())}" if given else f"{name}:footprint=auto"


def robot_setup(name_or_path: str | Path) -> RobotSetup:
    """Return what "my_car.urdf:left_rear_wheel_joint=rl_wheel,footprint=hull" names.

    Settings may stand in a YAML file beside the URDF, `my_car.roles.yaml`; those in the name go before.

    Raises:
        AssetError: there is no such URDF.
        RobotError: a setting is none, or the YAML file cannot be read.
    """
    name, given = _split(str(name_or_path))
    path = find_asset("urdf", name, ".urdf").resolve()
    beside = path.with_name(roles_file(path))
    written = _from_yaml(beside) if is_file(beside) else {}
    values = {**_checked(beside, written), **_checked(path, given)}
    source = path.stem if path.parent == asset_folder("urdf").resolve() else str(path)
    if given:
        source += ":" + ",".join(f"{key}={value}" for key, value in given.items())
    return RobotSetup(
        path=path,
        source=source,
        roles={role: values.get(role, role) for role in ROLES},
        footprint=values.get("footprint", "auto"),
        numbers={key: float(values[key]) for key in NUMBERS if key in values},
        xacro={key.removeprefix(XACRO): value for key, value in values.items() if key.startswith(XACRO)},
    )


def roles_file(path: Path) -> str:
    """Return the name of the YAML file that may lie beside a URDF: car.urdf, car.xacro, car.urdf.xacro -> car."""
    return path.name.removesuffix(".xacro").removesuffix(".urdf") + ".roles.yaml"


def _split(name: str) -> tuple[str, dict[str, str]]:
    """Return the file and the settings in a name; where one is set twice, the last counts."""
    match = _SETTINGS.match(name)
    if match is None or is_file(name):
        return name, {}
    pairs = [pair.partition("=") for pair in match["settings"].split(",")]
    wrong = ["".join(pair) for pair in pairs if not (pair[1] and pair[2])]
    if wrong:
        raise RobotError(f"{shown(name)}: {shown(wrong[0])!r} is no setting; write KEY=VALUE, separated by commas")
    return match["file"], {key: value for key, _, value in pairs}


def _from_yaml(path: Path) -> dict[str, str]:
    values = read_yaml(path, RobotError)
    if not isinstance(values, dict):
        raise RobotError(f"{path}: must hold settings as `key: value`, got {shown(values)!r}; {_known()}")
    flat = {key: value for key, value in values.items() if key != "xacro"}
    arguments = values.get("xacro") or {}
    if not isinstance(arguments, dict):
        raise RobotError(f"{path}: xacro must hold arguments as `name: value`, got {shown(arguments)!r}")
    return {
        key: _text(path, key, value)
        for key, value in (flat | {XACRO + name: value for name, value in arguments.items()}).items()
    }


def _text(path: Path, key: str, value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if not isinstance(value, str | int | float):
        raise RobotError(f"{path}: {shown(key)} must be a name or a number, got {shown(value)!r}")
    return str(value)


def _checked(path: Path, values: dict[str, str]) -> dict[str, str]:
    """Return the settings that stand in a file, or behind its name, or raise with all that is wrong with them."""
    wrong = []
    for key, value in values.items():
        if key in NUMBERS:
            try:
                ok = math.isfinite(float(value)) and float(value) > 0
            except ValueError:
                ok = False
            if ok and key.endswith("_limit_rad") and float(value) > ONCE_ROUND_RAD:
                wrong.append(
                    f"{key} is the {NUMBERS[key]}, no further than once round, got {shown(value)!r} rad; if "
                    f"degrees are meant, write {math.radians(float(value)):.4f}"
                )
            if not ok:
                wrong.append(f"{key} is the {NUMBERS[key]}, a number above 0, got {shown(value)!r}")
        elif key == "footprint":
            if value not in FOOTPRINTS:
                wrong.append(f"footprint must be one of {', '.join(FOOTPRINTS)}, got {shown(value)!r}")
        elif key not in ROLES and not key.startswith(XACRO):
            near = difflib.get_close_matches(key, (*ROLES, "footprint", *NUMBERS), 1)
            hint = f" (did you mean {near[0]}?)" if near else ""
            wrong.append(f"there is no setting {shown(key)!r}{hint}; {_known()}")
    if wrong:
        raise RobotError(f"{path}: " + "; ".join(wrong))
    return values


def _known() -> str:
    return f"there are {', '.join((*ROLES, 'footprint', *NUMBERS))} and xacro.ARGUMENT"
