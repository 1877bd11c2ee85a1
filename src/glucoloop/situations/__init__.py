"""Situations: everything about a loop in one tree of parts, the same in Python, in a file and on the command line."""
