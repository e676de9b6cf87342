"""Maps of one surface at the vertices of another, through spheres on which both are registered."""
