"""Published studies, each carried out again in full."""
