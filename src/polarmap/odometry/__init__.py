"""Direct sparse odometry."""
