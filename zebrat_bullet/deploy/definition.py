"""What an exported policy observes and commands, as JSON that any program can read: `policy.json`."""

import hashlib
import json
import math
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from zebrat_bullet.config import FlattenConfig
from zebrat_bullet.deploy.car import Car
from zebrat_bullet.errors import PolicyError
from zebrat_bullet.files import read_json, refusing, shown
from zebrat_bullet.sensing.beams import beam_bearings
from zebrat_bullet.task.observation import LEAST_GAP_M, ObservationSpec

FORMAT = "zebrat-deploy-1"
DEFINITION_FILE, MODEL_FILE = "policy.json", "policy.onnx"
REMEDY = "export the policy again with `zebrat export`"
_MB = 1_000_000
_TRAIL: dict[str, Any] = {"trail_steps": [], "control_step_s": 0.0, "wheelbase_m": 0.0}
"""What the observation of a policy without a trail leaves out."""
_KINDS = {float: "a finite number", int: "a whole number", str: "a text", bool: "true or false"}


@dataclass(frozen=True, kw_only=True)
class Definition:
    """All of a policy but its network.

    Attributes:
        name: of the policy.
        head: what makes an action of the network's last layer; part of the network already.
        model_sha256: of `MODEL_FILE`, in hexadecimal digits.
        car: that it was trained for.
        control_step_s: time between two commands.
        n_bearings: of the flat scan, from -pi counter-clockwise.
        indices: (R,) the scan's bearings that the safety region watches.
        range_m: (R,) V_range, where each of them leaves the car's outline.
        observation: how V_obs and the last command are encoded, and how actions are decoded.
        flatten: height band of the scan.

    Raises:
        PolicyError: the numbers contradict each other.
    """

    name: str
    head: str
    model_sha256: str
    car: Car
    control_step_s: float
    n_bearings: int
    indices: tuple[int, ...]
    range_m: tuple[float, ...]
    observation: ObservationSpec
    flatten: FlattenConfig = field(default_factory=FlattenConfig)

    def __post_init__(self) -> None:
        seen, car = self.observation, self.car
        _require(bool(self.name.strip()), "a policy has a name")
        _require(not seen.waypoint, "it observes the next waypoint, which no car on the road is told")
        _require(0.001 <= self.control_step_s <= 10.0, f"control_step_s is 0.001 to 10, got {self.control_step_s}")
        _require(8 <= self.n_bearings <= 36_000, f"n_bearings is 8 to 36000, got {self.n_bearings}")
        _require(
            len(self.indices) == len(self.range_m) == seen.n_rays,
            f"{len(self.indices)} indices and {len(self.range_m)} ranges for {seen.n_rays} bearings",
        )
        _require(all(0 <= i < self.n_bearings for i in self.indices), f"indices are 0 to {self.n_bearings - 1}")
        _require(all(0.0 < r < 1000.0 for r in self.range_m), "range_m are above 0, in m")
        reckoned = (seen.control_step_s, seen.wheelbase_m) == (self.control_step_s, car.wheelbase_m)
        _require(reckoned or not seen.trail_steps, "the trail is reckoned for another control step or wheelbase")
        _require(seen.gap_ranges_m in ((), self.range_m), "gaps are measured from other ranges than range_m")
        _require(
            math.isclose(car.max_speed_mps, seen.max_speed_mps)
            and math.isclose(car.max_steering_rad, seen.max_steering_rad),
            "the car's limits are not those of the observation",
        )

    @property
    def actions(self) -> ObservationSpec:
        """Decodes the network's actions into commands."""
        # A policy of six commands names fractions of the limits, also where what it observes is in m/s and rad.
        return self.observation if self.head != "argmax" else _scaled(self.observation)

    def data(self) -> dict[str, Any]:
        """Return what `policy.json` holds; what follows from the rest is written out, for other programs."""
        data = self._data()
        return data | {"sha256": digest_of(data)}

    def _data(self) -> dict[str, Any]:
        bearings = beam_bearings(self.n_bearings)[list(self.indices)]
        limit_mps, limit_rad = self.observation.max_speed_mps, self.observation.max_steering_rad
        car = asdict(self.car)
        mount = car.pop("lidar_rotation_base")
        unit_mps, unit_rad = (1.0, 1.0) if self.actions.raw else (limit_mps, limit_rad)
        return {
            "format": FORMAT,
            "name": self.name,
            "model": {
                "file": MODEL_FILE,
                "sha256": self.model_sha256,
                "input": ["observation", "float32", ["N", self.observation.size]],
                "output": ["action", "float32", ["N", 2]],
                "head": self.head,
            },
            "control_step_s": self.control_step_s,
            "car": car,
            "scan": {
                "n_bearings": self.n_bearings,
                "first_bearing_rad": -math.pi,
                "bearing_step_rad": 2.0 * math.pi / self.n_bearings,
                "lidar_rotation_base": mount,
                **asdict(self.flatten),
            },
            "safety_region": {
                "indices": self.indices,
                "bearings_rad": tuple(bearings.tolist()),
                "range_m": self.range_m,
            },
            "observation": self._observation() | {"parts": self._parts()},
            "action": {
                "parts": [
                    {"what": "speed", "unit": "m/s", "times": unit_mps, "limit": limit_mps},
                    {"what": "steering", "unit": "rad", "times": unit_rad, "limit": limit_rad},
                ]
            },
        }

    def _observation(self) -> dict[str, Any]:
        seen = asdict(self.observation)
        return seen if self.observation.trail_steps else {name: seen[name] for name in seen if name not in _TRAIL}

    def _parts(self) -> list[dict[str, Any]]:
        """Return the parts of an observation in order; from `least` to `most` is scaled to -1 to 1 unless it is raw."""
        seen = self.observation
        reach = seen.range_max_m
        parts: list[tuple[str, str, int, float, float]] = [("V_obs", "m", seen.n_rays, 0.0, reach)]
        if seen.gap_ranges_m:
            least, most = math.log10(LEAST_GAP_M), math.log10(reach)
            parts.append((f"log10(max(V_obs - V_range, {LEAST_GAP_M:g} m))", "log10 m", seen.n_rays, least, most))
        if seen.last_command:
            speed, steering = seen.max_speed_mps, seen.max_steering_rad
            parts.append(("last speed", "m/s", 1, -speed, speed))
            parts.append(("last steering", "rad", 1, -steering, steering))
        for n, reach_m in zip(seen.trail_steps, seen.trail_reach_m, strict=True):
            parts += [(f"trail: {axis} {n} steps ago", "m", 1, -reach_m, reach_m) for axis in "xy"]
            parts += [(f"trail: {part} of yaw {n} steps ago", "1", 1, -1.0, 1.0) for part in ("sine", "cosine")]
        return [dict(zip(("what", "unit", "n", "least", "most"), part, strict=True)) for part in parts]


def read_definition(folder: Path) -> Definition:
    """Read the `policy.json` of an exported policy.

    Raises:
        PolicyError: there is none, or it is not as `zebrat export` writes it, to the last name.
    """
    path = folder / DEFINITION_FILE
    data = read_json(path, PolicyError, _MB)
    with refusing(path, PolicyError, f"is no definition of a policy in the format {FORMAT!r}", REMEDY):
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise ValueError(f"its format is {shown(repr(data.get('format') if isinstance(data, dict) else None))}")
        model, scan, region, seen = (_mapping(data, key) for key in ("model", "scan", "safety_region", "observation"))
        values = {
            "name": data["name"],
            "head": model["head"],
            "model_sha256": model["sha256"],
            "control_step_s": data["control_step_s"],
            "n_bearings": scan["n_bearings"],
            "indices": region["indices"],
            "range_m": region["range_m"],
            "car": _mapping(data, "car") | {"lidar_rotation_base": scan["lidar_rotation_base"]},
            "flatten": {f.name: scan[f.name] for f in fields(FlattenConfig)},
            "observation": {f.name: seen[f.name] for f in fields(ObservationSpec) if f.name not in _TRAIL}
            | {name: seen.get(name, none) for name, none in _TRAIL.items()},
        }
        definition: Definition = _typed(Definition, values, "policy")
        digest = data.get("sha256")
        _same(data, definition.data() | {"sha256": digest}, "policy")
        if digest != digest_of({key: value for key, value in data.items() if key != "sha256"}):
            raise ValueError("it was changed since it was written: its sha256 is another")
        return definition


def digest_of(data: dict[str, Any]) -> str:
    """Return the SHA-256 of plain data, in hexadecimal digits: against damage, not against who means harm."""
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def _require(ok: bool, message: str) -> None:
    if not ok:
        raise PolicyError(message)


def _scaled(spec: ObservationSpec) -> ObservationSpec:
    return ObservationSpec(**asdict(spec) | {"raw": False})


def _mapping(data: dict[str, Any], key: str) -> dict[str, Any]:
    value = data[key]
    if not isinstance(value, dict):
        raise ValueError(f"{key} is no mapping")
    return value


def _typed(kind: Any, value: Any, where: str) -> Any:
    """Return plain data as the kind a dataclass declares; nothing is converted but whole numbers to floats."""
    if hasattr(kind, "__dataclass_fields__"):
        hints = get_type_hints(kind)
        if not isinstance(value, dict) or value.keys() != hints.keys():
            raise ValueError(f"{where} needs exactly {', '.join(hints)}")
        return kind(**{name: _typed(hint, value[name], f"{where}.{name}") for name, hint in hints.items()})
    if get_origin(kind) is tuple:
        inner = get_args(kind)
        n = None if inner[-1] is ... else len(inner)
        if not isinstance(value, list) or (n is not None and len(value) != n):
            raise ValueError(f"{where} is a list{'' if n is None else f' of {n}'}, got {shown(repr(value))}")
        return tuple(_typed(inner[0], item, where) for item in value)
    whole = kind is float and type(value) is int
    if (type(value) is not kind and not whole) or (kind is float and not abs(value) < 1e9):
        raise ValueError(f"{where} must be {_KINDS[kind]}, got {shown(repr(value))}")
    return float(value) if whole else value


def _same(data: Any, made: Any, where: str) -> None:
    """Raise unless what was read is what the definition writes, floats to their last digits."""
    if isinstance(made, dict):
        if not isinstance(data, dict) or data.keys() != made.keys():
            raise ValueError(f"{where} needs exactly {', '.join(made)}")
        for key in made:
            _same(data[key], made[key], f"{where}.{key}")
    elif isinstance(made, list | tuple):
        if not isinstance(data, list) or len(data) != len(made):
            raise ValueError(f"{where} is a list of {len(made)}, got {shown(repr(data))}")
        for i, (got, expected) in enumerate(zip(data, made, strict=True)):
            _same(got, expected, f"{where}[{i}]")
    else:
        number = isinstance(made, float) and type(data) in (int, float)
        if not (math.isclose(data, made, rel_tol=1e-9, abs_tol=1e-9) if number else data == made):
            raise ValueError(f"{where} contradicts the rest: it must be {made!r}, got {shown(repr(data))}")
