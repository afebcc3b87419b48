"""Rules that make a device a robot: admission, kinematics, velocity gate, odometry, names; pure."""
