"""Search for a tuning that is robust to people and noise, and its check on other subjects."""
