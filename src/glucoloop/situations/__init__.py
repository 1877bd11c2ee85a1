"""Situations: everything about a loop in one tree of components, the same in Python, in files and in options."""
