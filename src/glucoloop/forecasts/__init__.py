"""Forecasts of glucose from a record: methods of which each is one class, and how well they do on days held out.

A method joins `glucoloop forecast` by one class, entered in `method.METHODS` or by the entry point of another
package in the group ``glucoloop.forecast_methods``.
"""
