"""Cohorts: virtual people under controllers, and what becomes of them."""
