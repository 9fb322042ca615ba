"""Two results of one kind side by side."""
