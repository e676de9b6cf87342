"""Many at once: the subjects of a cohort or the points of a sweep on Dask's workers, their tables, and statistics over
subjects at the vertices of a template.

``measure_subject`` and ``sweep``: what one worker does. Statistics begin in ``map_statistics`` (``fit_study``);
``overlap`` compares nets.
"""
