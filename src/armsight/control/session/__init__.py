"""Who drives a robot, by a connection or from a page, and the loop beyond shared memory that obeys them."""
