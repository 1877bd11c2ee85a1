"""Detection and sizing of meals that are not announced, estimator by estimator."""
