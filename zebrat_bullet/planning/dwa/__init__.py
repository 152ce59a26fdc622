"""The dynamic window approach as ROS's dwa_local_planner does it, for a car (Fox, Burgard, Thrun 1997)."""

from zebrat_bullet.planning.dwa.config import TUNED, DwaConfig
from zebrat_bullet.planning.dwa.planner import DwaPlanner

__all__ = ["TUNED", "DwaConfig", "DwaPlanner"]
