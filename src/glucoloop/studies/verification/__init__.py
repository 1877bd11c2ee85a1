"""Random loops with random faults, and what every loop promises at every sample."""

from glucoloop.studies.verification.campaign import Campaign, catalogue_controller, met, run_campaign

__all__ = ["Campaign", "catalogue_controller", "met", "run_campaign"]
