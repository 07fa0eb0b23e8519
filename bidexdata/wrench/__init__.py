"""Contact forces and the wrenches they make: what regions, optimisation and metrics share."""
