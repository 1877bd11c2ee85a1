"""Published constants of the Hovorka model, one set in a file."""
