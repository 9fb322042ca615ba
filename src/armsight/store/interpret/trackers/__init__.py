"""What trackers and laboratories' programs write, by one table of kinds."""

from armsight.store.interpret.trackers.formats import TRACKERS, TrackerFormat, no_bodies, tracker_of, tracker_table
