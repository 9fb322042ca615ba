"""The only place that touches hardware: cameras, robots, files as cameras."""
