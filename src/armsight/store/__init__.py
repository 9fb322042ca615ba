"""Files, written so that a crash cannot eat them."""
