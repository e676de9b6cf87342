"""A grown cortex beside the folds of the person it grew from.

Both lie on the person's sphere, so each vertex of one has a place on the other. The smooth body that grew is the
control: unfolding leaves the largest sulci in it.
"""
