"""Linear models of a patient, as a controller sees them."""
