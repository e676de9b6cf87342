"""Pages of groups, sweeps, and models over subjects, with their pictures."""
