"""A bridge to ROS 2: a process of its own. Only `node`, `routes` and `parameters` need rclpy."""
