"""Published parameter sets, one file each; every value with its unit and its place in print."""
