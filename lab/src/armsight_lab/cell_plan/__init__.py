"""What plans the motion that calibrates a cell, and what that motion will tell: run_cell_plan in cell_plan.run."""
