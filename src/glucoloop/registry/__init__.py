"""Names of what can be chosen: patients, controllers, faults, and what can be set about each."""
