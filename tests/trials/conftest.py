"""Trials without a simulator."""

from pretend_trials import _make_trial, _pretend, _tiny  # noqa: F401
