"""What a URDF says of a car-like robot; the only source of its numbers.

`load_robot` goes in short steps: `setup` (which file, which joint plays which role), `document` (the tree, checked),
`parts` (the joints of the roles; all others are held still), `chassis` (base frame and axles), `body` (outline and
mass), `motors` (limits), and, unless the file is `written` as physics needs it, the `plain` car that is driven instead.
"""

from zebrat_bullet.robot.fit import fitted, most_steering_rad, within_limits
from zebrat_bullet.robot.load import Inspection, inspect_robot, load_robot, refusal, robot_of
from zebrat_bullet.robot.model import GRAVITY_MPS2, LIDAR_JOINT, ROLES, STEERING_JOINTS, WHEEL_JOINTS, RobotModel
from zebrat_bullet.robot.setup import named_robot, robot_setup

__all__ = [
    "GRAVITY_MPS2",
    "LIDAR_JOINT",
    "ROLES",
    "STEERING_JOINTS",
    "WHEEL_JOINTS",
    "Inspection",
    "RobotModel",
    "fitted",
    "inspect_robot",
    "load_robot",
    "most_steering_rad",
    "named_robot",
    "refusal",
    "robot_of",
    "robot_setup",
    "within_limits",
]
