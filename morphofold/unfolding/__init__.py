"""Unfold a cortex by heat flow on its sphere: smooth surfaces with the vertices of the folded one."""
