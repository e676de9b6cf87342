"""Inference on maps of many subjects: linear models at every vertex, and permutations over the whole surface."""
