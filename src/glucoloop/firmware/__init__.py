"""Export of a controller for a microcontroller: a folder with its C, recorded samples, a self-test and a report."""
