"""Search of a grid: every tuning of a controller in one situation, and their order."""
