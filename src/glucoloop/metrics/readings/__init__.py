"""Metrics of a record of a continuous glucose monitor, as the consensus defines them: of readings with gaps, by NumPy.

`series.Readings` holds what was read, or a simulated course; `catalogue.MEASURES` lists every metric once.
"""
