"""A bridge to ROS 2: a process of its own beside the daemon. Only `node` and `routes` need rclpy."""
