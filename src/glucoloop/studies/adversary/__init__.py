"""The worst plausible sensor errors: what a search finds that makes a controller do the most harm."""
