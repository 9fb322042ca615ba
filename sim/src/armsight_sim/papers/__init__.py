"""What only the papers need: their own rigs and calibrations, as printed and corrected, to reproduce their tables."""
