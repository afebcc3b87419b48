"""The daemon as a node of a ROS 1 graph, without a ROS installation."""
