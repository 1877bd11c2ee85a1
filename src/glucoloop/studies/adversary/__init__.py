"""Search for the worst plausible sensor errors, which make a controller do the most harm."""
