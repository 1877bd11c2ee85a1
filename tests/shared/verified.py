"""Results of a verification, without a folder."""

from contextlib import suppress

from glucoloop.studies.verification import Verification, study


def results_of_verification(progress, **settings):
    """What a verification with these settings counts, until it is done or interrupted."""
    campaign, parts = study.search(Verification(**settings)), []
    with suppress(KeyboardInterrupt):
        parts.extend(campaign.missing(parts, progress))
    return campaign.results_of(parts).plain
