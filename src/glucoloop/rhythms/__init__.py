"""Rhythms: sensitivity to insulin and production of glucose that follow the time of day and differ from day to day."""
