"""How simulated lenses bend light."""
