"""Cohorts: virtual people under controllers, and their results."""
