"""Stress test: controllers, with and without a guard, under one fault after another."""
