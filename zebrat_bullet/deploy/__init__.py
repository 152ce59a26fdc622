"""What drives a real car: a policy as ONNX and the supervisor around it. Needs numpy and onnxruntime, nothing else.

A test runs it where torch, PyBullet, gymnasium, Open3D, shapely, pydantic and PyYAML are not installed.
"""

from zebrat_bullet.deploy.car import Car
from zebrat_bullet.deploy.decision import Decision
from zebrat_bullet.deploy.definition import Definition
from zebrat_bullet.deploy.driver import Driver, Limits

__all__ = ["Car", "Decision", "Definition", "Driver", "Limits"]
