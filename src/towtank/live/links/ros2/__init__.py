"""A ROS 2 system."""
