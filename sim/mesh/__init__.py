"""Meshes of bodies: generated layers of bricks, or tetrahedra from a file."""
