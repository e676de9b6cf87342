"""Finite elements in blocks: bricks and patches of tetrahedra, and the kernels that compute their forces."""
