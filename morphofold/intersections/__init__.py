"""Exact detection of self-intersections of a surface."""
