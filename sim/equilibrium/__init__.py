"""Rest, equilibrium and loss of stability of a body: distance from rest, Newton's method, exact stiffness."""
