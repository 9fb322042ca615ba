"""Sets of pictures and tables that a person takes for one calibration, with the truth beside them."""
