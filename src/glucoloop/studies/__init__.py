"""Studies of controllers, one folder each: stress, detection, verification, the worst sensor errors, robust tuning."""
