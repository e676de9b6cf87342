"""What the solver, the measures and a cohort cost on this machine."""
