"""What the motors of a car can do, from the limits of its joints or what the user says of them."""

import math
from dataclasses import dataclass

from zebrat_bullet.robot.model import GRAVITY_MPS2, STEERING_JOINTS, WHEEL_JOINTS
from zebrat_bullet.robot.parts import Parts, called
from zebrat_bullet.robot.setup import ONCE_ROUND_RAD, RobotSetup

MOST_KNUCKLE_RAD = 1.4
LEAST_KNUCKLE_RAD = 0.02
MOST_HINGE_SPEED_RADPS = 20.0
"""No servo turns faster; exporters write a million."""
_HINGE_SPEED_RADPS = 4.0
_ACCELERATION_MPS2 = 4.0
_SCRUB = 0.4
_UNEVEN_RAD = 0.01
_LEAST_PULL_MPS2, _LEAST_SPEED_MPS, _LEAST_HINGE_RADPS = 0.02, 0.01, 0.02


@dataclass(frozen=True)
class Motors:
    """Limits of the motors, the smallest of left and right, front and rear.

    Attributes:
        knuckle_rad, hinge_speed_radps, hinge_effort_nm: of the steering hinges.
        wheel_speed_radps: of the wheels; infinite where the URDF names none.
        wheel_effort_nm: of each wheel.
        as_written: the URDF writes all of them.
    """

    knuckle_rad: float
    hinge_speed_radps: float
    hinge_effort_nm: float
    wheel_speed_radps: float
    wheel_effort_nm: float
    as_written: bool


def find_motors(
    parts: Parts, setup: RobotSetup, mass_kg: float, radius_m: float
) -> tuple[Motors, list[str], list[str]]:
    """Return the motors, what is wrong with them (each with its mend), and what was taken for lack of limits."""
    problems: list[str] = []
    notes: list[str] = []
    defaults = {
        "hinge_effort_nm": _SCRUB * mass_kg * GRAVITY_MPS2 * radius_m,
        "hinge_speed_radps": _HINGE_SPEED_RADPS,
        "wheel_effort_nm": _ACCELERATION_MPS2 * mass_kg * radius_m / 4.0,
        "wheel_speed_radps": math.inf,
    }
    values: dict[str, float] = {}
    for setting, roles, limit in (
        ("hinge_effort_nm", STEERING_JOINTS, "effort"),
        ("hinge_speed_radps", STEERING_JOINTS, "velocity"),
        ("wheel_effort_nm", WHEEL_JOINTS, "effort"),
        ("wheel_speed_radps", WHEEL_JOINTS, "velocity"),
    ):
        if setting in setup.numbers:
            values[setting] = setup.numbers[setting]
            continue
        written = {role: _limit(parts, role, limit) for role in roles}
        wrong = [called(r, parts.joints[r].get("name")) for r, v in written.items() if v is not None and v <= 0]
        if wrong:
            problems.append(
                f"{', '.join(wrong)}: <limit> must have {limit} above 0; write what the motor gives, "
                f"or say {setting}=..."
            )
        given = [value for value in written.values() if value is not None and value > 0]
        values[setting] = min(given, default=defaults[setting])
        if not given and not wrong and math.isfinite(values[setting]):
            notes.append(
                f"no {limit} limit is written of {roles[0]} and its like; {setting}={values[setting]:.3g} is taken"
            )
    problems += [] if problems else _too_weak(values, mass_kg, radius_m)
    knuckle, wrong_limits, said = steering_limit(parts, setup)
    problems += wrong_limits
    as_written = not notes and not problems and not setup.numbers
    return Motors(knuckle, as_written=as_written, **values), problems, notes + said


def _too_weak(values: dict[str, float], mass_kg: float, radius_m: float) -> list[str]:
    """Return what is too little to drive with."""
    pull, top = (
        4.0 * values["wheel_effort_nm"] / (radius_m * max(mass_kg, 1e-9)),
        values["wheel_speed_radps"] * radius_m,
    )
    found = {
        "wheel_effort_nm": (pull, _LEAST_PULL_MPS2, "m/s2, what the wheels can pull this car with"),
        "wheel_speed_radps": (top, _LEAST_SPEED_MPS, "m/s, how fast the wheels can roll"),
        "hinge_speed_radps": (values["hinge_speed_radps"], _LEAST_HINGE_RADPS, "rad/s, how fast the hinges can turn"),
    }
    return [
        f"{value:.2g} {what}, is too little to drive with (at least {least}); mend <limit>, or say {setting}=..."
        for setting, (value, least, what) in found.items()
        if value < least
    ]


def steering_limit(parts: Parts, setup: RobotSetup) -> tuple[float, list[str], list[str]]:
    """Return how far in rad both hinges can turn to both sides, what is wrong with their limits, and what was taken."""
    problems: list[str] = []
    notes: list[str] = []
    limit = setup.numbers.get("steering_limit_rad")
    if limit is None:
        limit = _knuckle_limit(parts, problems, notes)
    if limit > MOST_KNUCKLE_RAD:
        notes.append(f"the hinges may turn by {limit:.3g} rad; {MOST_KNUCKLE_RAD} rad is taken, the most there is")
    return min(limit, MOST_KNUCKLE_RAD), problems, notes


def _knuckle_limit(parts: Parts, problems: list[str], notes: list[str]) -> float:
    limits = []
    for role in STEERING_JOINTS:
        lower, upper = _limit(parts, role, "lower"), _limit(parts, role, "upper")
        name = called(role, parts.joints[role].get("name"))
        if parts.types[role] not in ("revolute", "continuous", "fixed"):
            problems.append(f"{name} is {parts.types[role]}; make it revolute")
        elif parts.types[role] == "fixed" or lower is None or upper is None:
            problems.append(
                f"{name} ({parts.types[role]}) has no limits; make it revolute with <limit lower upper>, or say "
                "steering_limit_rad=..."
            )
        elif min(-lower, upper) < LEAST_KNUCKLE_RAD:
            problems.append(
                f"{name} turns from {lower} to {upper} rad, so it cannot steer to both sides; write its lower and "
                "upper limits, or say steering_limit_rad=..."
            )
        elif min(-lower, upper) > ONCE_ROUND_RAD:
            problems.append(
                f"{name} turns from {lower:g} to {upper:g} rad, further than once round; if degrees are meant, write "
                f"{math.radians(lower):.4f} to {math.radians(upper):.4f}, or say steering_limit_rad=..."
            )
        else:
            limits.append(min(upper, -lower))
            if abs(upper + lower) > _UNEVEN_RAD:
                notes.append(f"{name} turns from {lower:g} to {upper:g} rad; {limits[-1]:g} to both sides is taken")
    return min(limits, default=MOST_KNUCKLE_RAD)


def _limit(parts: Parts, role: str, name: str) -> float | None:
    limit = parts.joints[role].find("limit")
    text = None if limit is None else limit.get(name)
    return None if text is None else float(text)
