"""Do the residuals of a run agree with what is claimed? If not: what is wrong, and what it does to the poses."""
