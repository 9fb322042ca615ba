"""The operator at the page: who drives, the enable that is held, and the work that moves the robot meanwhile."""
