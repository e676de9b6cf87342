"""How far folds can be trusted: meshes and seeds held against each other."""
