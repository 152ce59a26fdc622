"""Settings of the task: reward, observation, episode; and all of it together."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Real

from zebrat_bullet.config.car import ENGINES, DisturbanceConfig, DynamicsConfig, PhysicsConfig
from zebrat_bullet.config.checks import of_their_kinds, require, within
from zebrat_bullet.config.senses import FlattenConfig, LidarConfig, NoiseConfig, SafetyRegionConfig
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.files import shown


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
        of_their_kinds(self)
        object.__setattr__(self, "weights", dict(self.weights))
        for name, weight in self.weights.items():
            require(isinstance(weight, Real), f"weights: {name} must be a number, got {shown(repr(weight))}")
        require(0 < self.discount <= 1, f"discount must be in (0, 1], got {self.discount}")
        require(self.log_base > 1, f"log_base must be above 1, got {self.log_base}")
        within(self, log_base=(1.0, 1e6), **dict.fromkeys(("collision", "success", "false_exit", "stall"), (-1e9, 1e9)))
        wrong = {shown(name): weight for name, weight in self.weights.items() if not abs(weight) <= 1e9}
        require(not wrong and len(self.weights) <= 100, f"weights are at most 100 numbers up to 1e9, got {wrong}")


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


MOST_TRAIL_STEPS = 1000
"""The longest memory, in control steps."""


@dataclass(frozen=True, kw_only=True)
class ObservationConfig:
    """What is observed beside V_obs.

    Attributes:
        log_gaps: the logarithm of each gap, V_obs - V_range: a centimetre at the wall is lost in a range of up to 6 m.
        last_command: the last speed and steering (paper: 32 + 2 numbers).
        waypoint: distance and yaw difference to the next waypoint, for guided agents.
        trail_steps: where the car was so many control steps ago, reckoned from its commands: a memory, for who must
            know whether it has come from there, or goes to and fro.
    """

    log_gaps: bool = False
    last_command: bool = True
    waypoint: bool = False
    trail_steps: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if isinstance(self.trail_steps, Iterable):
            object.__setattr__(self, "trail_steps", tuple(self.trail_steps))
        of_their_kinds(self)
        within(self, trail_steps=(1, MOST_TRAIL_STEPS))


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
        of_their_kinds(self)
        require(self.max_steps >= 1 and self.stall_steps >= 1, "max_steps and stall_steps must be at least 1")
        within(self, max_steps=(1, 1_000_000), stall_steps=(1, 2**31 - 1), stall_distance_m=(-1e6, 1e6))
        within(self, open_width_m=(-1e6, 1e6), out_m=(-1e6, 1e6))
        within(self, anywhere_yaw_rad=(0.0, math.pi))
        starts = ("start", "anywhere", "either")
        require(self.start in starts, f"start must be one of {', '.join(starts)}, got {self.start!r}")


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
        of_their_kinds(self)
        step, delay = self.physics.control_step_s, self.dynamics.delay_s[1]
        require(delay <= 2 * step, f"dynamics.delay_s may be two control steps ({2 * step} s) at most, got {delay}")

    @property
    def guided(self) -> bool:
        """Whether reward or observation look at the world's waypoints."""
        return self.observation.waypoint or bool(self.reward.weights.get("W"))


def with_engine(task: TaskConfig, engine: str) -> TaskConfig:
    """Return the task in another engine, whose own ray caster stands in for that of the one before."""
    caster = engine if task.lidar.caster in ENGINES else task.lidar.caster
    return replace(task, physics=replace(task.physics, engine=engine), lidar=replace(task.lidar, caster=caster))


def require_planar_cars(task: TaskConfig) -> None:
    """Refuse a task that is guided, or disturbs what planar cars do not have.

    Raises:
        ConfigError: it is or does; the message names what.
    """
    require(not task.guided, "planar cars drive unguided, this task looks at waypoints; drive it in PyBullet")
    asked, none = vars(task.disturbance), vars(DisturbanceConfig())
    if unknown := [f"disturbance.{name}" for name in asked if asked[name] != none[name]]:
        raise ConfigError(f"planar cars have no {', '.join(unknown)}; leave them out, or drive it in PyBullet")
    step, delay = task.physics.control_step_s, task.dynamics.delay_s[1]
    require(
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
    require(name in REWARD_PRESETS, f"unknown reward preset {name!r}; valid are: {', '.join(REWARD_PRESETS)}")
    observation = _GUIDED_OBSERVATIONS.get(name, task.observation)
    return replace(task, reward=replace(REWARD_PRESETS[name]), observation=observation)  # weights of its own
