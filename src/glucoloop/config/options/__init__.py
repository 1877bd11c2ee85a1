"""Keys of configurations, each declared once; no numerical library is imported, so that help is shown at once."""
