"""Random loops with random faults, and the promises that every loop keeps at every sample."""
