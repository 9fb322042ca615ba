"""One recording of a moving arm calibrates its whole cell: lenses, rig, timing, base, target and the arm itself."""
