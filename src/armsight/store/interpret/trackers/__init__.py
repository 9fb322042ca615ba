"""What trackers and laboratories' programs write, by one table of kinds: formats.TRACKERS."""
