"""Every setting of the car, its senses and its task: frozen, validated once, varied by `dataclasses.replace`."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown

ENGINES = ("bullet", "mujoco")
CASTERS = ("bullet", "embree", "mujoco")
MOST_SEED = 2**31 - 1
"""Greatest seed of a run; its evaluations and their episodes draw from seeds beyond it."""


FOOTPRINTS = ("auto", "collision", "hull")
"""What may count as the outline of a car's body, see `robot.setup`."""


def _require(ok: bool, message: str) -> None:
    if not ok:
        raise ConfigError(message)


def within(config: object, **bounds: tuple[float, float]) -> None:
    """Raise unless each named number of a settings dataclass, or each of a tuple of them, is within its bounds.

    Raises:
        ConfigError: one is not, or is no finite number; None counts as within.
    """
    for name, (least, most) in bounds.items():
        value = getattr(config, name)
        for each in value if isinstance(value, tuple) else (value,):
            # A number that is none compares as False with both.
            _require(each is None or least <= each <= most, f"{name} must be {least:g} to {most:g}, got {each}")


@dataclass(frozen=True, kw_only=True)
class PhysicsConfig:
    """How the physics is stepped.

    Attributes:
        engine: "bullet" (PyBullet), or "mujoco", the second judge, which cuts each physics step into steps of at most
            `sim.mujoco.model.TIMESTEP_S` and takes neither solver iterations nor contact breaking.
        control_step_s: time between two commands (paper: 0.2 s).
        rate_hz: physics steps a second; a control step must hold a whole number of them.
        solver_iterations: constraint solver iterations; 20 leave a speed error of 0.3 %.
        contact_breaking_m: distance at which a contact is dropped; Bullet's 0.02 keeps stale wheel contacts, whose cost
            is 100 us a physics step against 40.
        max_speed_mps, max_steering_rad: limits of a command; commands beyond them are clipped.
    """

    engine: str = "bullet"
    control_step_s: float = 0.2
    rate_hz: float = 120.0
    solver_iterations: int = 20
    contact_breaking_m: float = 1e-5
    max_speed_mps: float = 0.6
    max_steering_rad: float = 0.6

    def __post_init__(self) -> None:
        _require(self.engine in ENGINES, f"engine must be one of {', '.join(ENGINES)}, got {shown(self.engine)!r}")
        _require(self.control_step_s > 0 and self.rate_hz > 0, "control_step_s and rate_hz must be above 0")
        within(self, control_step_s=(0.001, 10.0), rate_hz=(0.1, 10_000.0), solver_iterations=(-math.inf, 1000))
        n = self.control_step_s * self.rate_hz
        _require(
            abs(n - round(n)) < 1e-6 and round(n) >= 1,
            f"control_step_s {self.control_step_s} holds {n:g} physics steps at {self.rate_hz} Hz; "
            "choose a rate that gives a whole number",
        )
        _require(self.solver_iterations >= 1, f"solver_iterations must be at least 1, got {self.solver_iterations}")
        _require(self.max_speed_mps > 0, f"max_speed_mps must be above 0, got {self.max_speed_mps}")
        _require(
            0 < self.max_steering_rad < math.pi / 2,
            f"max_steering_rad must be in (0, pi/2), got {self.max_steering_rad}",
        )
        within(self, contact_breaking_m=(0.0, 1.0), max_speed_mps=(0.0, 100.0))

    @property
    def n_substeps(self) -> int:
        """Physics steps in a control step."""
        return self.steps_in(self.control_step_s)

    def steps_in(self, time_s: float) -> int:
        """Return the nearest number of physics steps in a time."""
        return round(time_s * self.rate_hz)


@dataclass(frozen=True, kw_only=True)
class LidarConfig:
    """The beams of the lidar (defaults: Velodyne VLP-16 at one degree).

    Attributes:
        n_channels, n_bearings: beams above each other, and around.
        elevation_min_rad, elevation_max_rad: lowest and highest channel.
        range_max_m: reach.
        caster: "bullet" (rayTestBatch) and "mujoco" (mj_multiRay) cast in the engine of that name, "embree" (Open3D
            RaycastingScene) beside either.
        bearings: "all", or "region": a drive casts only the bearings that the safety region and the open-space rule
            look at, a tenth of them, while nobody asks for whole scans; what these two see is the same to the last bit.
    """

    n_channels: int = 16
    n_bearings: int = 360
    elevation_min_rad: float = math.radians(-15.0)
    elevation_max_rad: float = math.radians(15.0)
    range_max_m: float = 6.0
    caster: str = "bullet"
    bearings: str = "all"

    def __post_init__(self) -> None:
        _require(self.caster in CASTERS, f"caster must be one of {', '.join(CASTERS)}, got {shown(self.caster)!r}")
        _require(self.bearings in ("all", "region"), f"bearings must be 'all' or 'region', got {self.bearings!r}")
        _require(self.n_channels >= 1 and self.n_bearings >= 8, "a lidar needs at least 1 channel and 8 bearings")
        _require(
            -math.pi / 2 < self.elevation_min_rad <= self.elevation_max_rad < math.pi / 2,
            "elevations must satisfy -pi/2 < min <= max < pi/2",
        )
        _require(self.range_max_m > 0, f"range_max_m must be above 0, got {self.range_max_m}")
        within(self, n_channels=(1, 1024), n_bearings=(8, 36_000), range_max_m=(0.01, 1000.0))
        n_beams = self.n_channels * self.n_bearings
        _require(n_beams <= 2_000_000, f"a lidar has at most 2,000,000 beams, got {n_beams}")


@dataclass(frozen=True, kw_only=True)
class NoiseConfig:
    """Lidar imperfections, applied between cloud and scan; all off by default.

    Attributes:
        range_sigma_m: Gaussian range noise along each ray (VLP-16: 0.008 m in the authors' URDF).
        dropout: probability that a return is lost.
        mount_xyz_m, mount_yaw_rad: error of the mount that the flattening does not know of.
    """

    range_sigma_m: float = 0.0
    dropout: float = 0.0
    mount_xyz_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount_yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        _require(self.range_sigma_m >= 0, f"range_sigma_m must be at least 0, got {self.range_sigma_m}")
        _require(0 <= self.dropout <= 1, f"dropout is a probability, got {self.dropout}")
        within(self, range_sigma_m=(0.0, 100.0), mount_xyz_m=(-10.0, 10.0), mount_yaw_rad=(-10.0, 10.0))


Range = tuple[float, float]
"""Least and greatest value of a uniform draw."""
Margins = float | Range | Mapping[str, float | Range]
"""A margin in m, a range of which each episode draws its own, or either by family of tracks, `OTHER` for the rest."""
OTHER = "other"


@dataclass(frozen=True, kw_only=True)
class DynamicsConfig:
    """How the car differs from what its URDF says, drawn anew for each episode; nothing by default.

    Attributes:
        acceleration: factor on the torque of the wheel motors.
        steering_rate: factor on the speed of the steering hinges.
        steering_offset_rad: added to the steering of every command.
        speed: factor on the speed of every command.
        delay_s: time until a command reaches the motors, two control steps at most (planar cars: one); until then those
            before it hold.
    """

    acceleration: Range = (1.0, 1.0)
    steering_rate: Range = (1.0, 1.0)
    steering_offset_rad: Range = (0.0, 0.0)
    speed: Range = (1.0, 1.0)
    delay_s: Range = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name, (least, most) in vars(self).items():
            _require(least <= most, f"dynamics.{name} must be [least, greatest], got [{least}, {most}]")
            if name != "steering_offset_rad":
                _require(least >= 0, f"dynamics.{name} must be at least 0, got {least}")
        for name in ("acceleration", "steering_rate"):
            _require(getattr(self, name)[0] > 0, f"dynamics.{name} must be above 0, got {getattr(self, name)[0]}")
        within(self, **dict.fromkeys(vars(self), (-1000.0, 1000.0)))

    @property
    def fixed(self) -> bool:
        """Whether every car is as its URDF says."""
        return self == DynamicsConfig()


@dataclass(frozen=True, kw_only=True)
class DisturbanceConfig:
    """What else disturbs an episode in PyBullet and MuJoCo, drawn anew for each from its seed; nothing by default.

    What concerns the lidar comes on top of `NoiseConfig`. Planar cars know none of this, and refuse it.

    Attributes:
        friction: factor on the grip of the tyres (ZebraT's on its floor: 1.0).
        mass: factor on mass and inertia of every part.
        steering_lag_s: time constant with which the steering follows its command, as a first-order lag.
        command_noise: sigma on what a command comes to at the motors, drawn for each, as a fraction of the limits; the
            driver does not learn of it.
        range_sigma_m: Gaussian range noise along each ray.
        dropout: probability that a return is lost.
        dark_walls: share of the walls' length that gives no return at any time of an episode, as dark or glassy
            walls do.
        mount_offset_m: error of the mount, level, in a direction drawn too.
        mount_yaw_rad: error of the mount's yaw.
        pose_sigma_m, pose_sigma_rad: of the errors of a localisation in x, in y and in yaw, for those that are given
            the pose; each drifts, as an Ornstein-Uhlenbeck process.
        pose_drift_s: time in which it does.
    """

    friction: Range = (1.0, 1.0)
    mass: Range = (1.0, 1.0)
    steering_lag_s: Range = (0.0, 0.0)
    command_noise: Range = (0.0, 0.0)
    range_sigma_m: Range = (0.0, 0.0)
    dropout: Range = (0.0, 0.0)
    dark_walls: Range = (0.0, 0.0)
    mount_offset_m: Range = (0.0, 0.0)
    mount_yaw_rad: Range = (0.0, 0.0)
    pose_sigma_m: float = 0.0
    pose_sigma_rad: float = 0.0
    pose_drift_s: float = 10.0

    def __post_init__(self) -> None:
        for name, (least, most) in _DISTURBANCES.items():
            drawn = getattr(self, name)
            low, high = drawn if isinstance(drawn, tuple) else (drawn, drawn)
            _require(low <= high, f"disturbance.{name} must be [least, greatest], got [{low}, {high}]")
            got = f"[{low}, {high}]" if isinstance(drawn, tuple) else drawn
            ok = least <= low and high <= most
            _require(ok, f"disturbance.{name} must be within {least:g} to {most:g}, got {got}")


_DISTURBANCES = {
    "friction": (0.01, 10.0),
    "mass": (0.1, 10.0),
    "steering_lag_s": (0.0, 10.0),
    "command_noise": (0.0, 10.0),
    "range_sigma_m": (0.0, 100.0),
    "dropout": (0.0, 1.0),
    "dark_walls": (0.0, 1.0),
    "mount_offset_m": (0.0, 1.0),
    "mount_yaw_rad": (-math.pi, math.pi),
    "pose_sigma_m": (0.0, 100.0),
    "pose_sigma_rad": (0.0, math.pi),
    "pose_drift_s": (0.001, 1e6),
}
"""Least and greatest value of each."""

VLP16_NOISE = NoiseConfig(range_sigma_m=0.008, dropout=0.01)
"""The noise of the authors' lidar, and one return in a hundred lost."""
RANDOM_DYNAMICS = DynamicsConfig(
    acceleration=(0.7, 1.3),
    steering_rate=(0.7, 1.3),
    steering_offset_rad=(-0.02, 0.02),
    speed=(0.9, 1.05),
    delay_s=(0.0, 0.05),
)
"""Cars as they come: what a policy for a real one should bear."""


@dataclass(frozen=True, kw_only=True)
class FlattenConfig:
    """The height band whose points make the 2D scan.

    Attributes:
        height_min_m, height_max_m: its ends, in m above the floor.
    """

    height_min_m: float = 0.05
    height_max_m: float = 0.80

    def __post_init__(self) -> None:
        _require(
            self.height_min_m < self.height_max_m,
            f"height_min_m {self.height_min_m} must be below height_max_m {self.height_max_m}",
        )
        within(self, height_min_m=(-1000.0, 1000.0), height_max_m=(-1000.0, 1000.0))


@dataclass(frozen=True, kw_only=True)
class SafetyRegionConfig:
    """Which representation watches the car's outline, and how finely (paper, Algorithm 1).

    Attributes:
        kind: "sr" (safety region), "firect" (even angles, outline ranges) or "fifr" (even angles, one range).
        resolution_m: r of Algorithm 1, outline length between two bearings; 0.095 gives 32 of them on ZebraT.
        margin_m: how far the outline is enlarged on every side.
        gap_rad: greatest angle between two bearings of "sr"; where those along the outline lie farther apart, as ahead
            of a lidar on the nose, more are put evenly between them. The paper has none of these.
    """

    kind: str = "sr"
    resolution_m: float = 0.095
    margin_m: float = 0.0
    gap_rad: float = 2.0 * math.pi

    def __post_init__(self) -> None:
        _require(self.kind in ("sr", "firect", "fifr"), f"kind must be 'sr', 'firect' or 'fifr', got {self.kind!r}")
        _require(self.resolution_m > 0, f"resolution_m must be above 0, got {self.resolution_m}")
        _require(self.margin_m >= 0, f"margin_m must be at least 0, got {self.margin_m}")
        within(self, resolution_m=(0.001, 100.0), margin_m=(0.0, 100.0), gap_rad=(0.001, 2.0 * math.pi))


@dataclass(frozen=True, kw_only=True)
class RewardConfig:
    """Weights and settings of the reward (paper, eq. 3-9, Table I).

    Attributes:
        weights: weight of each term by its name in `task/rewards.py`; a term that is absent or 0 is off.
        collision, success: R_c and R_r, paid alone on the terminal step; what ends an episode is the same under every
            reward, so waypoint guidance too is paid R_r for open space and not for its last waypoint.
        false_exit: what is paid where the car takes the inside of a wide corner for open space; None: R_r, as in the
            paper, whose car cannot tell the two apart.
        stall: what is paid where the car stays where it is, which then ends the task; None: the episode is cut off
            there, as in the paper, and standing still costs nothing.
        discount: gamma of the sums over rays.
        log_base: base of the logarithm in O; the paper writes "log", the authors' code uses 10. With the natural
            logarithm every step in a 1.2 m corridor costs so much that an agent learns to crash at once.
    """

    weights: Mapping[str, float] = field(default_factory=lambda: {"F": 1.0, "O": 1.0, "M": 1.0, "T": 1.0})
    collision: float = -50.0
    success: float = 50.0
    false_exit: float | None = None
    stall: float | None = None
    discount: float = 0.9
    log_base: float = 10.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", dict(self.weights))
        _require(0 < self.discount <= 1, f"discount must be in (0, 1], got {self.discount}")
        _require(self.log_base > 1, f"log_base must be above 1, got {self.log_base}")
        within(self, log_base=(1.0, 1e6), **dict.fromkeys(("collision", "success", "false_exit", "stall"), (-1e9, 1e9)))
        wrong = {shown(name): weight for name, weight in self.weights.items() if not abs(weight) <= 1e9}
        _require(not wrong and len(self.weights) <= 100, f"weights are at most 100 numbers up to 1e9, got {wrong}")


REWARD_PRESETS = {
    "fomt": RewardConfig(),
    "fot": RewardConfig(weights={"F": 1.0, "O": 1.0, "T": 1.0}),
    "fmt": RewardConfig(weights={"F": 1.0, "M": 1.0, "T": 1.0}),
    "ft": RewardConfig(weights={"F": 1.0, "T": 1.0}),
    "wg": RewardConfig(weights={"W": 100.0}),
    "wg_paper": RewardConfig(weights={"W": 100.0}),
}
"""F O M T and its ablations, and waypoint guidance (eq. 9); `wg` and `wg_paper` differ in what goes with them, see
`with_reward`."""


@dataclass(frozen=True, kw_only=True)
class ObservationConfig:
    """What is observed beside V_obs.

    Attributes:
        log_gaps: the logarithm of each gap, V_obs - V_range: a centimetre at the wall is lost in a range of up to 6 m.
        last_command: the last speed and steering (paper: 32 + 2 numbers).
        waypoint: distance and yaw difference to the next waypoint, for guided agents.
    """

    log_gaps: bool = False
    last_command: bool = True
    waypoint: bool = False


@dataclass(frozen=True, kw_only=True)
class EpisodeConfig:
    """When an episode ends (DESIGN: success, collision, time-out, stall) and where it begins.

    Attributes:
        max_steps: control steps until time-out.
        stall_steps, stall_distance_m: the car fails when it moved less than this distance between two checks.
        open_width_m: V_left + V_right above this is open space.
        out_m: the car is out once its lidar is so far past the open-space line, whatever it sees: beyond the line, the
            track's own outer wall can hide the open space.
        start: "start" (the world's start pose with its random range), "anywhere" (along the centre line), or "either"
            (one as often as the other).
        anywhere_yaw_rad: "anywhere", the car is turned from the path by so much at most.
    """

    max_steps: int = 1000
    stall_steps: int = 70
    stall_distance_m: float = 0.2
    open_width_m: float = 8.0
    out_m: float = 0.6
    start: str = "start"
    anywhere_yaw_rad: float = 0.5

    def __post_init__(self) -> None:
        _require(self.max_steps >= 1 and self.stall_steps >= 1, "max_steps and stall_steps must be at least 1")
        within(self, max_steps=(1, 1_000_000), stall_steps=(1, 2**31 - 1), stall_distance_m=(-1e6, 1e6))
        within(self, open_width_m=(-1e6, 1e6), out_m=(-1e6, 1e6))
        within(self, anywhere_yaw_rad=(0.0, math.pi))
        starts = ("start", "anywhere", "either")
        _require(self.start in starts, f"start must be one of {', '.join(starts)}, got {self.start!r}")


@dataclass(frozen=True, kw_only=True)
class TaskConfig:
    """The whole task: the car in a world, its senses, its observation, its reward and its episode rules.

    Attributes:
        robot: name of a shipped car, or a URDF, with settings of it after a colon.
    """

    robot: str = "zebrat"
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    dynamics: DynamicsConfig = field(default_factory=DynamicsConfig)
    lidar: LidarConfig = field(default_factory=LidarConfig)
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    disturbance: DisturbanceConfig = field(default_factory=DisturbanceConfig)
    flatten: FlattenConfig = field(default_factory=FlattenConfig)
    region: SafetyRegionConfig = field(default_factory=SafetyRegionConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    episode: EpisodeConfig = field(default_factory=EpisodeConfig)

    def __post_init__(self) -> None:
        step, delay = self.physics.control_step_s, self.dynamics.delay_s[1]
        _require(delay <= 2 * step, f"dynamics.delay_s may be two control steps ({2 * step} s) at most, got {delay}")

    @property
    def guided(self) -> bool:
        """Whether reward or observation look at the world's waypoints."""
        return self.observation.waypoint or bool(self.reward.weights.get("W"))


def with_engine(task: TaskConfig, engine: str) -> TaskConfig:
    """Return the task in another engine, whose own ray caster stands in for that of the one before."""
    caster = engine if task.lidar.caster in ENGINES else task.lidar.caster
    return replace(task, physics=replace(task.physics, engine=engine), lidar=replace(task.lidar, caster=caster))


def require_planar_cars(task: TaskConfig) -> None:
    """Refuse a task that disturbs what planar cars do not have.

    Raises:
        ConfigError: it does; the message names what.
    """
    asked, none = vars(task.disturbance), vars(DisturbanceConfig())
    if unknown := [f"disturbance.{name}" for name in asked if asked[name] != none[name]]:
        raise ConfigError(f"planar cars have no {', '.join(unknown)}; leave them out, or drive it in PyBullet")
    step, delay = task.physics.control_step_s, task.dynamics.delay_s[1]
    _require(
        delay <= step,
        f"planar cars obey within a control step ({step} s), got dynamics.delay_s up to {delay}; lower it, or drive it "
        "in PyBullet",
    )


_GUIDED_OBSERVATIONS = {
    "wg": ObservationConfig(waypoint=True),
    "wg_paper": ObservationConfig(last_command=False, waypoint=True),
}


def with_reward(task: TaskConfig, name: str) -> TaskConfig:
    """Return the task with a reward preset, and with the observation that it needs.

    The rewards of waypoint guidance observe the next waypoint: "wg" beside the last command (36 numbers), "wg_paper"
    instead of it (the paper's 32 + 2). The others leave the task's observation as it is.

    Raises:
        ConfigError: there is no such preset; the message lists those there are.
    """
    _require(name in REWARD_PRESETS, f"unknown reward preset {name!r}; valid are: {', '.join(REWARD_PRESETS)}")
    observation = _GUIDED_OBSERVATIONS.get(name, task.observation)
    return replace(task, reward=REWARD_PRESETS[name], observation=observation)
