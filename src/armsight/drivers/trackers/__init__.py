"""Trackers of other makers, live: poses of one body as they come, each by its maker's public library."""
