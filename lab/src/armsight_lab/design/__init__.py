"""What a rig will measure before it is bought or built, and what to change for a wanted accuracy."""
