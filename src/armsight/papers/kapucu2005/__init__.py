"""Kapucu and Baysec 2005: the beacon's centroid and place, a joint from its circle, the table."""
