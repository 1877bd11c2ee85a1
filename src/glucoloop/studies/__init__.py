"""What the commands compute: one run, identifications and bounds, and the studies of controllers, one folder each."""
