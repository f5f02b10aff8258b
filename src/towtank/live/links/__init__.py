"""Sources of samples: JSON, MAVLink, motion capture, ROS 2, and recordings played again; `urls` opens each by text."""
