"""Zenoh: one session for the fleet of daemons, and for ROS 2 by the protocol of rmw_zenoh."""
