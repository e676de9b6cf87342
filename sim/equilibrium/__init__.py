"""Rest, equilibrium and loss of stability of a body: gauges, Newton's method, exact stiffness."""
