"""The error terms of a timed elastic band, pure functions; the cost of a band is the sum of weight times error squared.

A step of the band leads from one pose (x, y, yaw of the rear axle's centre) to the next in the time dt.
"""

import math
from typing import NamedTuple

from numba import njit


class Costs(NamedTuple):
    """Bounds and weights of the terms; `TebConfig` says what each means."""

    max_vel_x_mps: float
    max_vel_x_backwards_mps: float
    max_vel_theta_radps: float
    acc_lim_x_mps2: float
    acc_lim_theta_radps2: float
    min_turning_radius_m: float
    min_obstacle_dist_m: float
    inflation_dist_m: float
    penalty_epsilon: float
    weight_kinematics_nh: float
    weight_kinematics_forward_drive: float
    weight_kinematics_turning_radius: float
    weight_max_vel_x: float
    weight_max_vel_theta: float
    weight_acc_lim_x: float
    weight_acc_lim_theta: float
    weight_optimaltime: float
    weight_obstacle: float
    weight_inflation: float
    weight_viapoint: float
    weight_prefer_rotdir: float


@njit(cache=True, error_model="numpy")
def wrap(angle: float) -> float:
    """Return the same direction in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@njit(cache=True, error_model="numpy")
def below(value: float, bound: float, epsilon: float) -> float:
    """Return by how much a value is below a bound, felt `epsilon` early."""
    return max(0.0, bound + epsilon - value)


@njit(cache=True, error_model="numpy")
def outside(value: float, low: float, high: float, epsilon: float) -> float:
    """Return by how much a value is outside [low, high], felt `epsilon` early at both ends."""
    return max(0.0, low + epsilon - value, value - high + epsilon)


@njit(cache=True, error_model="numpy")
def non_holonomic(dx: float, dy: float, yaw: float, next_yaw: float) -> float:
    """Return how far a step is from an arc: 0 where both headings make the same angle with the chord."""
    return (math.cos(yaw) + math.cos(next_yaw)) * dy - (math.sin(yaw) + math.sin(next_yaw)) * dx


@njit(cache=True, error_model="numpy")
def too_tight(distance: float, turn: float, min_radius: float) -> float:
    """Return by how much the turning radius of a step falls short of the smallest one, in m."""
    return 0.0 if turn == 0.0 else below(distance / abs(turn), min_radius, 0.0)


@njit(cache=True, error_model="numpy")
def velocity(dx: float, dy: float, yaw: float, dt: float) -> float:
    """Return the speed of a step in m/s, below 0 in reverse; a smooth sign keeps it differentiable at rest."""
    forward = 100.0 * (dx * math.cos(yaw) + dy * math.sin(yaw))
    return math.hypot(dx, dy) / dt * forward / (1.0 + abs(forward))


@njit(cache=True, error_model="numpy")
def acceleration(before: float, after: float, dt: float) -> float:
    """Return the mean acceleration between two (angular) speeds that lie `dt` apart."""
    return (after - before) / dt
