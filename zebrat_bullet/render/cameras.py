"""Where the views look from: a chase camera that trails the car, and a north-up view from straight above."""

import math

from vtkmodules.vtkRenderingCore import vtkCamera

from zebrat_bullet.geometry import wrap_angle
from zebrat_bullet.types import Pose2

# Steep enough to see the car over a 1 m wall right behind it.
_BACK_M, _HEIGHT_M, _AHEAD_M = 2.1, 3.1, 0.45
_SETTLE_S = 0.6
_JUMP_M = 1.0
_TOP_HEIGHT_M, _TOP_HALF_SPAN_M = 15.0, 3.6


class ChaseCamera:
    """Stands behind and above the car and turns after it with a short delay, so that the picture stays calm."""

    def __init__(self, camera: vtkCamera) -> None:
        self._camera = camera
        self._camera.SetViewUp(0.0, 0.0, 1.0)
        self._camera.SetViewAngle(46.0)
        self._camera.SetClippingRange(0.5, 40.0)
        self._pose: Pose2 | None = None
        self._time_s = self._yaw = 0.0

    def follow(self, pose: Pose2, time_s: float) -> None:
        """Look at a car at `pose` at `time_s`; a jump in time or place starts afresh behind the car."""
        share = 1.0 if self._has_jumped(pose, time_s) else 1.0 - math.exp((self._time_s - time_s) / _SETTLE_S)
        self._yaw = wrap_angle(self._yaw + share * wrap_angle(pose.yaw - self._yaw))
        self._pose, self._time_s = pose, time_s
        c, s = math.cos(self._yaw), math.sin(self._yaw)
        self._camera.SetPosition(pose.x - _BACK_M * c, pose.y - _BACK_M * s, _HEIGHT_M)
        self._camera.SetFocalPoint(pose.x + _AHEAD_M * c, pose.y + _AHEAD_M * s, 0.15)

    def _has_jumped(self, pose: Pose2, time_s: float) -> bool:
        if self._pose is None or time_s < self._time_s:
            return True
        return math.hypot(pose.x - self._pose.x, pose.y - self._pose.y) > _JUMP_M


class TopCamera:
    """Looks straight down on the car, x to the right and y up, without perspective."""

    def __init__(self, camera: vtkCamera) -> None:
        self._camera = camera
        self._camera.ParallelProjectionOn()
        self._camera.SetViewUp(0.0, 1.0, 0.0)
        self._camera.SetParallelScale(_TOP_HALF_SPAN_M)
        self._camera.SetClippingRange(0.5, _TOP_HEIGHT_M + 1.0)

    def follow(self, pose: Pose2) -> None:
        """Put the car in the middle."""
        self._camera.SetPosition(pose.x, pose.y, _TOP_HEIGHT_M)
        self._camera.SetFocalPoint(pose.x, pose.y, 0.0)
