"""A lidar's driver, of a kind: hands on /points as /points_relayed, until it is killed."""

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

rclpy.init()
node = Node("relay")
publisher = node.create_publisher(PointCloud2, "points_relayed", qos_profile_sensor_data)
node.create_subscription(PointCloud2, "points", publisher.publish, qos_profile_sensor_data)
rclpy.spin(node)
