"""Published constants of the Hovorka model, one set per file."""
