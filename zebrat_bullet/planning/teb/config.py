"""Settings of the timed elastic band: the names and defaults of teb_local_planner, with units."""

import math
from dataclasses import dataclass

from zebrat_bullet.config import PhysicsConfig, none_negative
from zebrat_bullet.errors import ConfigError
from zebrat_bullet.planning.local_costmap import check_costmap
from zebrat_bullet.planning.teb.costs import Costs
from zebrat_bullet.robot import RobotModel


@dataclass(frozen=True, kw_only=True)
class TebConfig:
    """What a band costs, how it is optimised, and when it is thrown away.

    Defaults are those of teb_local_planner; where its tutorial for car-like robots differs and was followed, it says
    so. What the car itself decides (speed, turning radius, turning rate) comes from the robot.

    Attributes:
        costmap: what the band keeps off: "map", the exact walls of the premade map, or "live", the cells of a
            `LocalCostmap` of the scans. The global plan is made over the map with either.
        dt_ref_s, dt_hysteresis_s: the band is resized until its time steps are within dt_ref +- dt_hysteresis.
        min_samples, max_samples: fewest and most time steps that resizing leaves.
        max_global_plan_lookahead_dist_m: length of the global plan that the band covers (tutorial).
        global_plan_viapoint_sep_m: distance between points of the global plan that attract the band; 0 for none.
        global_plan_prune_distance_m: farther than this from the global plan, a new one is asked for.
        force_reinit_new_goal_dist_m, force_reinit_new_goal_angular_rad: a local goal that jumps farther than this
            begins a new band.
        feasibility_check_no_poses: poses beyond the first whose exact footprint must be free of walls.
        xy_goal_tolerance_m: nearer than this to the end of the global plan, the car stops.
        max_vel_x_backwards_mps: fastest reversing (tutorial).
        acc_lim_x_mps2, acc_lim_theta_radps2: limits of acceleration.
        min_obstacle_dist_m: distance to keep from the footprint to every wall (paper: 0.3; in ROS's tutorial 0.27
            includes half the width of the car, because the footprint there is a line).
        inflation_radius_m: the paper's dilation radius. Around walls the global plan's costmap is inflated by it, and
            it is the band's inflation_dist: walls nearer than this cost a little, of no effect unless it is above
            `min_obstacle_dist_m`.
        obstacle_association_force_inclusion_factor: walls nearer to a pose than this many `min_obstacle_dist_m` are
            all felt by it.
        obstacle_association_cutoff_factor: beyond, only the nearest on each side, up to this many.
        penalty_epsilon: every bound is felt this much before it is reached.
        no_inner_iterations, no_outer_iterations: steps of the optimiser between resizings, and resizings.
        weight_adapt_factor: the obstacle weight grows by this factor with each outer iteration.
        weight_*: of each squared error. As in ROS, the forward drive is not asked of car-like robots.
        shrink_horizon_min_duration_s: how long the horizon stays halved after an infeasible band.
        oscillation_filter_duration_s: over how much driving an oscillation is looked for.
        oscillation_eps: mean speed and turning rate, as fractions of their limits, below which it is one.
        oscillation_recovery_min_duration_s: how long the turning direction is then held.
    """

    costmap: str = "map"
    dt_ref_s: float = 0.3
    dt_hysteresis_s: float = 0.1
    min_samples: int = 3
    max_samples: int = 100
    max_global_plan_lookahead_dist_m: float = 3.0
    global_plan_viapoint_sep_m: float = 0.0
    global_plan_prune_distance_m: float = 1.0
    force_reinit_new_goal_dist_m: float = 1.0
    force_reinit_new_goal_angular_rad: float = 0.5 * math.pi
    feasibility_check_no_poses: int = 5
    xy_goal_tolerance_m: float = 0.2
    max_vel_x_backwards_mps: float = 0.2
    acc_lim_x_mps2: float = 0.5
    acc_lim_theta_radps2: float = 0.5
    min_obstacle_dist_m: float = 0.3
    inflation_radius_m: float = 0.3
    obstacle_association_force_inclusion_factor: float = 1.5
    obstacle_association_cutoff_factor: float = 5.0
    penalty_epsilon: float = 0.05
    no_inner_iterations: int = 5
    no_outer_iterations: int = 4
    weight_adapt_factor: float = 2.0
    weight_kinematics_nh: float = 1000.0
    weight_kinematics_forward_drive: float = 0.0
    weight_kinematics_turning_radius: float = 1.0
    weight_max_vel_x: float = 2.0
    weight_max_vel_theta: float = 1.0
    weight_acc_lim_x: float = 1.0
    weight_acc_lim_theta: float = 1.0
    weight_optimaltime: float = 1.0
    weight_obstacle: float = 50.0
    weight_inflation: float = 0.1
    weight_viapoint: float = 1.0
    weight_prefer_rotdir: float = 50.0
    shrink_horizon_min_duration_s: float = 10.0
    oscillation_filter_duration_s: float = 10.0
    oscillation_eps: float = 0.1
    oscillation_recovery_min_duration_s: float = 10.0

    def __post_init__(self) -> None:
        check_costmap(self.costmap)
        if not 0.0 < self.dt_hysteresis_s < self.dt_ref_s:
            raise ConfigError(
                f"dt_hysteresis_s must lie between 0 and dt_ref_s {self.dt_ref_s}, got {self.dt_hysteresis_s}"
            )
        if not 3 <= self.min_samples <= self.max_samples:
            raise ConfigError(f"3 <= min_samples <= max_samples, got {self.min_samples} and {self.max_samples}")
        limits = (
            "max_global_plan_lookahead_dist_m",
            "max_vel_x_backwards_mps",
            "acc_lim_x_mps2",
            "acc_lim_theta_radps2",
        )
        for name in (*limits, "weight_optimaltime"):
            if not getattr(self, name) > 0.0:
                raise ConfigError(f"{name} must be above 0, got {getattr(self, name)}")
        for name in ("no_inner_iterations", "no_outer_iterations"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, got {getattr(self, name)}")
        none_negative(self)


TUNED = TebConfig(min_obstacle_dist_m=0.15)
"""Tuned on big_track: 0.3 cannot be kept in a passage under 1.2 m, and the car stands to and fro before its right
angles; 0.2 gets through, with some reversing; 0.15 is the most that does so without."""


def costs_for(config: TebConfig, robot: RobotModel, physics: PhysicsConfig) -> Costs:
    """Return the numbers that the cost terms need, with the limits of this car filled in."""
    given = {name: getattr(config, name) for name in Costs._fields if hasattr(config, name)}
    radius = robot.wheelbase_m / math.tan(physics.max_steering_rad)
    return Costs(
        **given,
        inflation_dist_m=config.inflation_radius_m,
        max_vel_x_mps=physics.max_speed_mps,
        max_vel_theta_radps=physics.max_speed_mps / radius,
        min_turning_radius_m=radius,
    )
