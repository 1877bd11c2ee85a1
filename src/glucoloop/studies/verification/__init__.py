"""Random loops with random faults, and what every loop promises at every sample."""
