"""A controller for a microcontroller: a folder with its C, recorded samples, a self-test and what was checked."""
