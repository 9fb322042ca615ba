"""Still frames -> the noise of a pixel by its grey level (photon transfer)."""
