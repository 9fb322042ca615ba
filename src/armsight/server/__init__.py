"""HTTP and the robot link."""
