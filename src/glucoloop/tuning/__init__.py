"""Tuning searches: every tuning of a grid in the loop, and which of them are any good."""
