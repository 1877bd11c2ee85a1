"""Trials: controllers by name, and what is done with them."""
