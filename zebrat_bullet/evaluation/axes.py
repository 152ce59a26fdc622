"""What a car and its senses may differ in from what a policy knows: the axes of the robustness grid."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from zebrat_bullet.config import Range, TaskConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown

EVERYTHING = "everything"
NOMINAL = "nominal"
"""Name of the level at which nothing is disturbed, which all axes share."""

_DEGREE = math.pi / 180.0


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One disturbance.

    Attributes:
        label: what the figure calls it, with the unit of its levels.
        part, setting: where it stands in the task: "dynamics" or "disturbance", and which of its ranges.
        levels: at which it is judged, but for `nominal`.
        nominal: the level at which it is none.
        whole: "everything" at 1 draws it so far from nominal.
        both_ways: to either side.
        unit: of a level, in that of the setting; None: a control step, in s.
    """

    label: str
    part: str
    setting: str
    levels: tuple[float, ...]
    nominal: float = 0.0
    whole: float
    both_ways: bool = False
    unit: float | None = 1.0

    def within(self, task: TaskConfig, between: Range) -> TaskConfig:
        """Return the task with this drawn between two levels.

        Raises:
            ConfigError: a level that cannot be.
        """
        unit = task.physics.control_step_s if self.unit is None else self.unit
        ranges = replace(getattr(task, self.part), **{self.setting: (between[0] * unit, between[1] * unit)})
        return replace(task, **{self.part: ranges})

    def around(self, task: TaskConfig, scale: float) -> TaskConfig:
        """Return the task with this drawn within a part of its whole from nominal."""
        far = scale * self.whole
        return self.within(task, (self.nominal - (far if self.both_ways else 0.0), self.nominal + far))


def _factor(label: str, part: str, setting: str, *levels: float) -> Axis:
    return Axis(label=label, part=part, setting=setting, levels=levels, nominal=1.0, whole=1.0, both_ways=True)


AXES = {
    "range_noise": Axis(
        label="range noise, sigma in m",
        part="disturbance",
        setting="range_sigma_m",
        levels=(0.01, 0.02, 0.05, 0.1),
        whole=0.05,
    ),
    "dropout": Axis(
        label="returns lost, share",
        part="disturbance",
        setting="dropout",
        levels=(0.1, 0.3, 0.6, 0.9),
        whole=0.5,
    ),
    "dark_walls": Axis(
        label="walls without return, share",
        part="disturbance",
        setting="dark_walls",
        levels=(0.05, 0.1, 0.2, 0.4),
        whole=0.2,
    ),
    "mount_offset": Axis(
        label="mount offset, m",
        part="disturbance",
        setting="mount_offset_m",
        levels=(0.02, 0.05, 0.1, 0.15),
        whole=0.1,
    ),
    "mount_yaw": Axis(
        label="mount yaw, degrees",
        part="disturbance",
        setting="mount_yaw_rad",
        levels=(-6.0, -3.0, 3.0, 6.0),
        whole=5.0,
        both_ways=True,
        unit=_DEGREE,
    ),
    "steering_lag": Axis(
        label="steering lag, s",
        part="disturbance",
        setting="steering_lag_s",
        levels=(0.1, 0.2, 0.4, 0.8),
        whole=0.5,
    ),
    "steering_offset": Axis(
        label="steering offset, degrees",
        part="dynamics",
        setting="steering_offset_rad",
        levels=(-6.0, -3.0, 3.0, 6.0),
        whole=6.0,
        both_ways=True,
        unit=_DEGREE,
    ),
    "speed": _factor("speed, factor", "dynamics", "speed", 0.7, 0.85, 1.15, 1.3),
    "latency": Axis(
        label="latency, control steps",
        part="dynamics",
        setting="delay_s",
        levels=(0.5, 1.0, 1.5, 2.0),
        whole=2.0,
        unit=None,
    ),
    "command_noise": Axis(
        label="command noise, of the limits",
        part="disturbance",
        setting="command_noise",
        levels=(0.1, 0.2, 0.3, 0.5),
        whole=0.5,
    ),
    "friction": _factor("friction, factor", "disturbance", "friction", 0.4, 0.6, 0.8, 1.2),
    "mass": _factor("mass, factor", "disturbance", "mass", 0.7, 0.85, 1.15, 1.3),
    "acceleration": _factor("torque of the wheels, factor", "dynamics", "acceleration", 0.5, 0.7, 1.3, 1.5),
    "steering_rate": _factor("speed of the steering, factor", "dynamics", "steering_rate", 0.25, 0.5, 0.75, 1.25),
}
EVERYTHING_LEVELS = (0.1, 0.2, 0.3, 0.5)
EVERYTHING_LABEL = "all of it at random, part of the whole"
AXIS_NAMES = (*AXES, EVERYTHING)
_BUT = f"{EVERYTHING} but "


def everything_but(left_out: Sequence[str]) -> str:
    """Return the name of the axis that draws everything but some of it.

    Raises:
        ConfigError: there is no such axis to leave out.
    """
    for axis in left_out:
        levels_of(axis)
    return _BUT + ",".join(left_out) if left_out else EVERYTHING


def is_everything(axis: str) -> bool:
    """Return whether an axis is of many at once."""
    return axis == EVERYTHING or axis.startswith(_BUT)


def levels_of(axis: str) -> tuple[float, ...]:
    """Return the levels at which an axis is judged, but for the one at which nothing is disturbed.

    Raises:
        ConfigError: there is no such axis; the message lists those there are.
    """
    if is_everything(axis):
        return EVERYTHING_LEVELS
    if axis not in AXES:
        raise ConfigError(f"no axis {shown(axis)!r}; there are {', '.join(AXIS_NAMES)}")
    return AXES[axis].levels


def nominal_of(axis: str) -> float:
    """Return the level of an axis at which nothing is disturbed."""
    return 0.0 if is_everything(axis) else AXES[axis].nominal


def label_of(axis: str) -> str:
    """Return what a figure calls an axis, with the unit of its levels."""
    if not is_everything(axis):
        return AXES[axis].label
    return EVERYTHING_LABEL + axis.removeprefix(EVERYTHING)


def disturbed(task: TaskConfig, axis: str, level: float) -> TaskConfig:
    """Return a task at a level of an axis; "everything" draws each within so much of its whole from nominal.

    Raises:
        ConfigError: a level that cannot be; the message names it.
    """
    if not math.isfinite(level):
        raise ConfigError(f"a level of {axis} is a finite number, got {level}")
    if axis == NOMINAL:
        return task
    if not is_everything(axis):
        return AXES[axis].within(task, (level, level))
    if not 0.0 <= level < 1.0:
        raise ConfigError(f"a level of everything is from 0 up to 1, 1 not included, got {level:g}")
    left_out = axis.removeprefix(_BUT).split(",")
    for name, each in AXES.items():
        task = task if name in left_out else each.around(task, level)
    return task


def parse_axes(texts: tuple[str, ...]) -> dict[str, tuple[float, ...]]:
    """Return the levels of each axis of texts "axis" and "axis=level,level", ascending, the undisturbed one with them.

    Raises:
        ConfigError: there is no such axis, or a level is no number.
    """
    axes: dict[str, tuple[float, ...]] = {}
    for text in texts:
        name, equals, given = text.partition("=")
        own = levels_of(name)
        try:
            levels = {float(each) for each in given.split(",")} if equals else set(own)
        except ValueError as error:
            raise ConfigError(f"levels are numbers, as in {name}={own[0]:g},{own[1]:g}; got {shown(text)!r}") from error
        axes[name] = tuple(sorted(levels | {nominal_of(name)}))
    return axes
