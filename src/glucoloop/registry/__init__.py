"""Catalogue of patients, controllers and faults by name, with their settings."""
