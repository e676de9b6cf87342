"""A grown cortex compared with the folds of the person it grew from.

A person's surface is unfolded until only its largest folds are left: the smooth body, from which the cortex grew, and
which is the control. All three lie on the person's sphere, so each vertex of one has a place on the others. Begin at
``compare_person``; ``common_sphere`` puts the three on the sphere, ``fold_axes`` and ``grown_regions`` measure them,
and ``person_agreement`` tests.
"""
