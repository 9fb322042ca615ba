"""Paths taught by showing: a target is led along, and the tip's pose at each exposure is kept."""

from armsight.control.teach.place import CarriedRig, RigPlace, StandingRig
from armsight.control.teach.recorder import PathRecorder, TeachCounts, Teaching

__all__ = ["CarriedRig", "PathRecorder", "RigPlace", "StandingRig", "TeachCounts", "Teaching"]
