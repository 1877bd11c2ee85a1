"""How well meals that nobody announced are detected and sized, estimator by estimator."""
