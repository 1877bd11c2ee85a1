"""Trials: virtual people under controllers, and the folder of their results."""
