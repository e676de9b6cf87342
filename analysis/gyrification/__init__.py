"""How folded a surface is: indices, sulcal depth, folding integrals, fractal dimension, spectrum, scaling law."""
