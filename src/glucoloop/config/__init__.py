"""Configurations: their keys, each declared once in `options`, and their reading."""
