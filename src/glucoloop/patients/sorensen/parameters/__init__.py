"""Published parameter sets, one file each; every value with its unit and where it was printed."""
