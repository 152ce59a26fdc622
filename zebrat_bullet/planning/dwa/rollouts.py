"""The speeds that a car can reach by the next control step, and where each would take it."""

import math

import numpy as np
from numpy.typing import NDArray

from zebrat_bullet.config import PhysicsConfig
from zebrat_bullet.planning.dwa.config import DwaConfig
from zebrat_bullet.types import Pose2


def velocity_window(
    speed: float, turn: float, config: DwaConfig, limits: PhysicsConfig, min_radius_m: float
) -> NDArray[np.float64]:
    """Return the (K, 2) samples v in m/s and w in rad/s that the car can reach in one control step.

    Args:
        speed, turn: the present v and w.
        config: samples and acceleration limits.
        limits: control step and largest speed.
        min_radius_m: smallest turning radius of the rear axle's centre: |w| never exceeds |v| / this.
    """
    slowest = -limits.max_speed_mps if config.allow_reverse else 0.0
    dv, dw = config.acc_lim_x * limits.control_step_s, config.acc_lim_theta * limits.control_step_s
    samples = []
    lowest, highest = np.clip([speed - dv, speed + dv], slowest, limits.max_speed_mps)
    for v in spread(lowest, highest, config.vx_samples):
        widest = min(config.max_vel_theta, abs(v) / min_radius_m)
        rightmost, leftmost = np.clip([turn - dw, turn + dw], -widest, widest)
        samples += [(v, w) for w in spread(rightmost, leftmost, config.vtheta_samples)]
    kept = [
        (v, w) for v, w in samples if abs(v) + 1e-4 >= config.min_vel_trans or abs(w) + 1e-4 >= config.min_vel_theta
    ]
    return np.array(kept).reshape(-1, 2)


def spread(low: float, high: float, n: int) -> NDArray[np.float64]:
    """Return n even samples from low to high, and 0 with them where it lies between; one where low is high."""
    if low == high:
        return np.array([low])
    samples = np.linspace(low, high, n)
    return np.unique(np.append(samples, 0.0)) if low < 0.0 < high else samples


def roll_out(pose: Pose2, samples: NDArray[np.float64], config: DwaConfig, rear_axle_x_m: float) -> NDArray[np.float64]:
    """Return (K, T, 3) x, y, yaw of the body's centre along the arcs of (K, 2) samples, from now to `sim_time_s`."""
    reach = np.abs(samples).max(axis=0) * config.sim_time_s
    n = math.ceil(max(reach[0] / config.sim_granularity_m, reach[1] / config.angular_sim_granularity_rad))
    time = np.linspace(0.0, config.sim_time_s, n + 1)
    v, w = samples[:, :1], samples[:, 1:]
    half = w * time / 2.0
    # The chord of an arc of length v t that turns by w t.
    chord = v * time * np.sinc(half / np.pi)
    yaw = pose.yaw + 2.0 * half
    x = pose.x + rear_axle_x_m * (math.cos(pose.yaw) - np.cos(yaw)) + chord * np.cos(pose.yaw + half)
    y = pose.y + rear_axle_x_m * (math.sin(pose.yaw) - np.sin(yaw)) + chord * np.sin(pose.yaw + half)
    return np.stack([x, y, yaw], axis=-1)
