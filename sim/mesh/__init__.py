"""Bodies as meshes: layers of bricks under a surface that is generated, tetrahedra from a file."""
