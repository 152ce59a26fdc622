"""What drives a real car: a policy as ONNX and the supervisor around it. Needs numpy and onnxruntime, nothing else.

A test runs it where torch, PyBullet, gymnasium, Open3D, shapely, pydantic and PyYAML are not installed.
"""
