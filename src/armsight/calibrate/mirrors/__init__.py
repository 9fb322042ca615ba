"""Mirror rigs: their calibration from boards, and what it says of how the mirrors stand."""
