"""Published constants of the model of Dalla Man et al., one set per file."""
