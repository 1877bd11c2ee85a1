"""Published people, one set in a file."""
