"""Episodes as MCAP files that ROS 2 tools read, and policies on what was recorded of any car, as bags of ROS."""
