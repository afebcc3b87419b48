"""Debian's ROS 1, with the system's Python, connected to the daemon."""
