"""Computation of the commands: one run, an identification, a bound, and the studies, each in a folder of its own."""
