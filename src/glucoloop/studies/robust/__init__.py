"""A tuning that holds for people and in noise: the search for it, and its check on others."""
