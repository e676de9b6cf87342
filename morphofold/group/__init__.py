"""Many at once: the subjects of a cohort or the points of a sweep on Dask's workers, their tables, and statistics over
subjects at the vertices of a template.

``task`` files: what one worker does. ``study`` is where statistics begin (``fit_study``); ``overlap`` compares nets.
"""
