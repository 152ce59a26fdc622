"""Timed elastic band, the local planner of ROS's teb_local_planner, for car-like robots.

Rösmann, Feiten, Wösch, Hoffmann, Bertram: "Trajectory modification considering dynamic constraints of autonomous
robots" (ROBOTIK 2012) and "Efficient trajectory optimization using a sparse model" (ECMR 2013).
"""
