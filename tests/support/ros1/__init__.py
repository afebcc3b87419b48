"""Debian's ROS 1, with the system's Python, beside the daemon."""
