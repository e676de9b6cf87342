"""What growth explains of a person's folds: experiments on unfolded hemispheres."""

#: the body of the experiments; its sulci crease within one brick
BODY_SETTINGS = ("material.mu_ratio=1.0", "effects.corner_barrier={}")
