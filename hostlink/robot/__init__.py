"""What makes a device a robot: kinematics, velocity gate, odometry; pure."""
