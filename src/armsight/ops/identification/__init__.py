"""Unknown arms identified from a beacon's sweeps: those of files and frames, and those made before live cameras."""
