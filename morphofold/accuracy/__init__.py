"""What accuracy costs: errors and times of many settings, their fronts, and what these say of a run to come."""
