"""What one car does in a control step: the inner loop, one source for processor and GPU.

Positions are relative to the origin of the car's world in the atlas.

Motion is Bullet's, as far as a plane has it (measured at 120 Hz and 20 solver iterations): each knuckle closes a tenth
of its error in a physics step, at its hinge's speed at most; four wheel motors pull the car, within their torque,
towards the ground speed that the command asks of each, along its own heading; the two front wheels resist sliding
sideways, within their grip. Speed and yaw rate of the rear axle are solved for all six by sequential impulses.
"""

from functools import cache

import warp as wp

from zebrat_bullet.planar.kernels.data import OPTIONS, CarData
from zebrat_bullet.planar.kernels.walls import Walls, clearance

N_SWEEPS = wp.constant(2)
"""Rounds of impulses in a physics step; Bullet does 20, the last ones change nothing that matters here."""
MOTOR_SHARE = wp.constant(0.0886)
"""Share of a wheel's speed error that its motor takes away in one round, while its torque lasts."""
GRIP_SHARE = wp.constant(0.23)
"""Share of a front wheel's sliding that its grip takes away in one round, while it lasts."""
KNUCKLE_SHARE = wp.constant(0.1)
"""Share of its error that a knuckle closes in a physics step: Bullet's position gain."""


@wp.func
def _tangent(angle: float):
    """Pade approximant of tan, within 1e-6 up to 0.9 rad."""
    square = angle * angle
    return angle * (105.0 - 10.0 * square) / (105.0 - 45.0 * square + square * square)


@wp.func
def _targets(asked: wp.vec2, car: CarData):
    """Knuckle angles in rad and ground speeds in m/s of the four wheels that a command asks for (`sim.ackermann`)."""
    slope = wp.tan(asked[1])
    swing = slope * car.half_track / car.wheelbase
    turn = slope * car.half_hinges / car.wheelbase
    beside = slope * car.beside / car.wheelbase
    left = 1.0 - turn
    right = 1.0 + turn
    front_l = wp.length(wp.vec2(left, slope)) - beside
    front_r = wp.length(wp.vec2(right, slope)) + beside
    speed = asked[0]
    fastest = wp.abs(speed) * wp.max(wp.max(1.0 - swing, 1.0 + swing), wp.max(front_l, front_r))
    if fastest > car.top:
        speed = speed * (car.top / fastest)
    speeds = wp.vec4(1.0 - swing, 1.0 + swing, front_l, front_r)
    return wp.vec2(wp.atan2(slope, left), wp.atan2(slope, right)), speed * speeds


X, Y, C, S, YAW, LEFT, RIGHT, SPEED, RATE, FREE, GOING, TORQUE, HINGE, LATE, OLD, NEW = (
    wp.constant(i) for i in (*range(15), 20)
)
N_ROWS = wp.constant(26)
"""What `drive` keeps of each car, a row each; OLD and NEW are the first of six: the knuckles and wheel speeds that the
command before asks for, and this one. A column is a car, so that one instruction serves many."""


@wp.func
def _impulses(
    speed: float,
    rate: float,
    left: float,
    right: float,
    rear_l: float,
    rear_r: float,
    front_l: float,
    front_r: float,
    torque: float,
    car: CarData,
):
    """Speed and yaw rate after a physics step; the four motors pull the wheels towards these ground speeds."""
    tan_l = _tangent(left)
    tan_r = _tangent(right)
    cos_l = 1.0 / wp.sqrt(1.0 + tan_l * tan_l)
    cos_r = 1.0 / wp.sqrt(1.0 + tan_r * tan_r)
    sin_l = tan_l * cos_l
    sin_r = tan_r * cos_r
    # How (speed, yaw rate) move each wheel along its heading, and the front wheels across theirs.
    roll_l = car.wheelbase * sin_l - car.half_hinges * cos_l - car.beside
    roll_r = car.wheelbase * sin_r + car.half_hinges * cos_r + car.beside
    slide_l = car.wheelbase * cos_l + car.half_hinges * sin_l
    slide_r = car.wheelbase * cos_r - car.half_hinges * sin_r
    im = car.inverse_mass
    ij = car.inverse_inertia
    h = car.half_track
    share = MOTOR_SHARE / (im + ij * h * h)
    share_l = MOTOR_SHARE / (im * cos_l * cos_l + ij * roll_l * roll_l)
    share_r = MOTOR_SHARE / (im * cos_r * cos_r + ij * roll_r * roll_r)
    side_l = GRIP_SHARE / (im * sin_l * sin_l + ij * slide_l * slide_l)
    side_r = GRIP_SHARE / (im * sin_r * sin_r + ij * slide_r * slide_r)
    p0 = float(0.0)
    p1 = float(0.0)
    p2 = float(0.0)
    p3 = float(0.0)
    p4 = float(0.0)
    p5 = float(0.0)
    for _sweep in range(N_SWEEPS):
        q = wp.clamp(p0 + share * (rear_l - speed + h * rate), -torque, torque)
        speed = speed + im * (q - p0)
        rate = rate - ij * h * (q - p0)
        p0 = q
        q = wp.clamp(p1 + share * (rear_r - speed - h * rate), -torque, torque)
        speed = speed + im * (q - p1)
        rate = rate + ij * h * (q - p1)
        p1 = q
        q = wp.clamp(p2 + share_l * (front_l - cos_l * speed - roll_l * rate), -torque, torque)
        speed = speed + im * cos_l * (q - p2)
        rate = rate + ij * roll_l * (q - p2)
        p2 = q
        q = wp.clamp(p3 + share_r * (front_r - cos_r * speed - roll_r * rate), -torque, torque)
        speed = speed + im * cos_r * (q - p3)
        rate = rate + ij * roll_r * (q - p3)
        p3 = q
        q = wp.clamp(p4 - side_l * (slide_l * rate - sin_l * speed), -car.grip_impulse, car.grip_impulse)
        speed = speed - im * sin_l * (q - p4)
        rate = rate + ij * slide_l * (q - p4)
        p4 = q
        q = wp.clamp(p5 - side_r * (slide_r * rate - sin_r * speed), -car.grip_impulse, car.grip_impulse)
        speed = speed - im * sin_r * (q - p5)
        rate = rate + ij * slide_r * (q - p5)
        p5 = q
    return speed, rate


@cache
def make_drive(n_abreast: int) -> wp.Kernel:
    """Return the kernel that drives every car one control step, so many of them in a thread."""

    @wp.kernel(module="unique", module_options=OPTIONS)
    def drive(
        car: CarData,
        corners: wp.array(dtype=wp.vec2),
        sides: wp.array(dtype=wp.vec3),
        walls: Walls,
        world: wp.array(dtype=int),
        dynamics: wp.array2d(dtype=float),  # torque, hinge speed, steering offset, speed: as `Dynamics`; late substeps
        margin: wp.array(dtype=float),  # walls count as touched when they are so near to the outline
        command: wp.array(dtype=wp.vec2),
        steering_limit: float,
        asked: wp.array(dtype=wp.vec2),  # the command that the motors follow, before it and after it
        pose: wp.array(dtype=wp.vec3),
        motion: wp.array(dtype=wp.vec4),  # knuckles, speed, yaw rate
        clear: wp.array(dtype=float),  # how far the outline may still move without touching anything
        contact: wp.array(dtype=wp.bool),
    ):
        """Drive every car one control step; a car stops where it touches a wall."""
        begin = wp.tid() * n_abreast
        most = pose.shape[0] - 1
        cars = wp.zeros(shape=(N_ROWS, n_abreast), dtype=float)
        for k in range(n_abreast):
            i = wp.min(begin + k, most)
            at = pose[i]
            c = wp.cos(at[2])
            s = wp.sin(at[2])
            cars[X, k] = at[0] + c * car.axle_x
            cars[Y, k] = at[1] + s * car.axle_x
            cars[C, k] = c
            cars[S, k] = s
            cars[YAW, k] = at[2]
            moved = motion[i]
            cars[LEFT, k] = moved[0]
            cars[RIGHT, k] = moved[1]
            cars[SPEED, k] = moved[2]
            cars[RATE, k] = moved[3]
            cars[FREE, k] = clear[i]
            cars[GOING, k] = 1.0
            cars[TORQUE, k] = car.motor_impulse * dynamics[i, 0]
            cars[HINGE, k] = car.hinge_step * dynamics[i, 1]
            cars[LATE, k] = dynamics[i, 4]
            if dynamics[i, 4] > 0.0:
                angles, speeds = _targets(asked[i], car)
                cars[OLD, k] = angles[0]
                cars[OLD + 1, k] = angles[1]
                for wheel in range(4):
                    cars[OLD + 2 + wheel, k] = speeds[wheel]
            fresh = wp.vec2(
                command[i][0] * dynamics[i, 3],
                wp.clamp(command[i][1] + dynamics[i, 2], -steering_limit, steering_limit),
            )
            angles, speeds = _targets(fresh, car)
            cars[NEW, k] = angles[0]
            cars[NEW + 1, k] = angles[1]
            for wheel in range(4):
                cars[NEW + 2 + wheel, k] = speeds[wheel]
        for n in range(car.n_substeps):
            for k in range(n_abreast):
                going = cars[GOING, k]
                is_new = float(n) >= cars[LATE, k]
                left = cars[LEFT, k]
                right = cars[RIGHT, k]
                speed, rate = _impulses(
                    cars[SPEED, k],
                    cars[RATE, k],
                    left,
                    right,
                    wp.where(is_new, cars[NEW + 2, k], cars[OLD + 2, k]),
                    wp.where(is_new, cars[NEW + 3, k], cars[OLD + 3, k]),
                    wp.where(is_new, cars[NEW + 4, k], cars[OLD + 4, k]),
                    wp.where(is_new, cars[NEW + 5, k], cars[OLD + 5, k]),
                    cars[TORQUE, k],
                    car,
                )
                most_turn = going * cars[HINGE, k]
                turn_l = KNUCKLE_SHARE * (wp.where(is_new, cars[NEW, k], cars[OLD, k]) - left)
                turn_r = KNUCKLE_SHARE * (wp.where(is_new, cars[NEW + 1, k], cars[OLD + 1, k]) - right)
                cars[LEFT, k] = left + wp.clamp(turn_l, -most_turn, most_turn)
                cars[RIGHT, k] = right + wp.clamp(turn_r, -most_turn, most_turn)
                cars[SPEED, k] = wp.where(going > 0.0, speed, cars[SPEED, k])
                cars[RATE, k] = wp.where(going > 0.0, rate, cars[RATE, k])
                step = going * speed * car.dt
                turn = going * rate * car.dt
                c = cars[C, k]
                s = cars[S, k]
                # Along the chord of the arc; the heading by its series, whose error is 1e-7 rad a step.
                cars[X, k] = cars[X, k] + step * (c - 0.5 * s * turn)
                cars[Y, k] = cars[Y, k] + step * (s + 0.5 * c * turn)
                turned = 1.0 - 0.5 * turn * turn
                cars[C, k] = c * turned - s * turn
                cars[S, k] = s * turned + c * turn
                cars[YAW, k] = cars[YAW, k] + turn
                cars[FREE, k] = cars[FREE, k] - (wp.abs(step) + wp.abs(turn) * car.farthest)
            least = float(1.0)
            for k in range(n_abreast):
                least = wp.min(least, wp.where(cars[GOING, k] > 0.0, cars[FREE, k], 1.0))
            if least <= 0.0:
                for k in range(n_abreast):
                    if cars[FREE, k] <= 0.0 and cars[GOING, k] > 0.0:
                        c = cars[C, k]
                        s = cars[S, k]
                        middle = wp.vec2(cars[X, k] - c * car.axle_x, cars[Y, k] - s * car.axle_x)
                        where = world[wp.min(begin + k, most)]
                        gap = clearance(walls, where, middle, c, s, car, corners, sides)
                        free = gap - margin[wp.min(begin + k, most)]
                        cars[FREE, k] = free
                        cars[GOING, k] = wp.where(free > 0.0, 1.0, 0.0)
        for k in range(n_abreast):
            i = wp.min(begin + k, most)
            pose[i] = wp.vec3(cars[X, k] - cars[C, k] * car.axle_x, cars[Y, k] - cars[S, k] * car.axle_x, cars[YAW, k])
            motion[i] = wp.vec4(cars[LEFT, k], cars[RIGHT, k], cars[SPEED, k], cars[RATE, k])
            clear[i] = cars[FREE, k]
            contact[i] = cars[GOING, k] == 0.0
            asked[i] = wp.vec2(
                command[i][0] * dynamics[i, 3],
                wp.clamp(command[i][1] + dynamics[i, 2], -steering_limit, steering_limit),
            )

    return drive
