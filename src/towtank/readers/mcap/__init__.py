"""MCAP files: our own, ROS 2, JSON."""
