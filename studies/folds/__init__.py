"""How far folds can be trusted: comparisons between meshes and between seeds."""
