"""Settings of zoom lenses."""
