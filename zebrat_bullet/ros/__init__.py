"""ROS 2: a node that drives a real car, and our PyBullet car as a robot for it to drive.

rclpy and message packages are imported here only. What drives needs no simulator: `python -m zebrat_bullet.ros drive`
runs with numpy, onnxruntime and rclpy alone.
"""
