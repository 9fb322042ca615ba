"""Is the arm where it says it is: measured poses held against commands, and the figures of ISO 9283."""
