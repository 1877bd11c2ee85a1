"""Experiments: what a situation is, and one place that makes a loop of it."""
