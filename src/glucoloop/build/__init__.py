"""Experiments: the description of a situation, and its assembly into a loop."""
