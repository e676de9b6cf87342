"""Time and memory of the solver, the measures and a cohort on this machine."""
