"""Elements in blocks: bricks and patches of tetrahedra, and the loops that compute their forces."""
