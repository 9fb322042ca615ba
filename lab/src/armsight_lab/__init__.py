"""What laboratories use: many runs at once, rigs and motions planned, histories. Reached by entry points."""
