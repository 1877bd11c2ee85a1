"""Tuning searches: every tuning of a grid in the loop, and the acceptable ones among them."""
