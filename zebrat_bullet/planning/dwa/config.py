"""Settings of the dynamic window approach: names and defaults of ROS noetic, but for what the car itself says."""

from dataclasses import dataclass

from zebrat_bullet.config import none_negative
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.planning.local_costmap import check_costmap

PRUNE_M = 1.0
"""The path begins at its first point within this distance of the car, as in ROS."""


@dataclass(frozen=True, kw_only=True)
class DwaConfig:
    """Settings of dwa_local_planner, its costmap and its global plan.

    Attributes:
        costmap: what the rollouts must not meet: "map", the premade map, or "live", a `LocalCostmap` of the scans. The
            global plan is made over the map with either.
        inflation_radius_m, cost_scaling_factor: the costmap's inflation layer (paper: 0.3 and 0.5).
        footprint_padding_m: how far the outline that must not meet a wall stands out of the car's.
        resolution_m, window_m: cell of the map; edge of the square local costmap about the car.
        global_planner: "dijkstra" or "astar".
        allow_reverse: sample backward speeds too.
        sim_time_s: length of a rollout.
        sim_granularity_m, angular_sim_granularity_rad: largest motion between two of its poses.
        vx_samples, vtheta_samples: speeds and turning speeds sampled; 0 is added where a range has both signs.
        acc_lim_x, acc_lim_theta: acceleration limits in m/s2 and rad/s2.
        min_vel_trans, min_vel_theta: a sample below both, in m/s and rad/s, is dropped.
        max_vel_theta: largest turning speed in rad/s; at |v| it is |v| / the smallest turning radius if that is less.
        path_distance_bias, goal_distance_bias: price of a metre off the path, and of a metre from the local goal.
        occdist_scale: price of one unit of costmap cost.
        forward_point_distance_m: where ahead of the centre the nose is that alignment and goal_front look at.
        scaling_speed_mps, max_scaling_factor: above this speed the footprint grows, by this part at full speed.
        oscillation_reset_dist_m, oscillation_reset_angle_rad: motion after which a change of direction is free again.
        xy_goal_tolerance_m: nearer to the goal the car stops.
    """

    costmap: str = "map"
    inflation_radius_m: float = 0.5
    cost_scaling_factor: float = 10.0
    footprint_padding_m: float = 0.01
    resolution_m: float = 0.05
    window_m: float = 6.0
    global_planner: str = "dijkstra"
    allow_reverse: bool = False
    sim_time_s: float = 1.7
    sim_granularity_m: float = 0.025
    angular_sim_granularity_rad: float = 0.1
    vx_samples: int = 3
    vtheta_samples: int = 20
    acc_lim_x: float = 2.5
    acc_lim_theta: float = 3.2
    min_vel_trans: float = 0.1
    min_vel_theta: float = 0.4
    max_vel_theta: float = 1.0
    path_distance_bias: float = 0.6
    goal_distance_bias: float = 0.8
    occdist_scale: float = 0.01
    forward_point_distance_m: float = 0.325
    scaling_speed_mps: float = 0.25
    max_scaling_factor: float = 0.2
    oscillation_reset_dist_m: float = 0.05
    oscillation_reset_angle_rad: float = 0.2
    xy_goal_tolerance_m: float = 0.1

    def __post_init__(self) -> None:
        check_costmap(self.costmap)
        positive = ("resolution_m", "sim_time_s", "sim_granularity_m", "angular_sim_granularity_rad")
        limits = ("inflation_radius_m", "acc_lim_x", "acc_lim_theta", "max_vel_theta")
        prices = ("path_distance_bias", "goal_distance_bias", "occdist_scale")
        for name in (*positive, *limits, *prices):
            if getattr(self, name) <= 0:
                raise ConfigError(f"{name} must be above 0, got {getattr(self, name)}")
        if self.window_m <= 2 * PRUNE_M:
            raise ConfigError(f"window_m must be above {2 * PRUNE_M:g} to hold some path, got {self.window_m}")
        for name in ("vx_samples", "vtheta_samples"):
            if getattr(self, name) < 2:
                raise ConfigError(f"{name} must be at least 2, got {getattr(self, name)}")
        none_negative(self)


TUNED = DwaConfig(sim_time_s=3.0, vx_samples=10, occdist_scale=0.05, footprint_padding_m=0.0)
"""Tuned on `big_track` alone, without reverse: ROS's own settings stop in its U-turn, these drive through."""
