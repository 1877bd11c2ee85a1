"""All studies that are declared, in the order of the help."""

from __future__ import annotations

from typing import Final

from glucoloop.studies.adversary import ADVERSARY
from glucoloop.studies.detection import DETECT
from glucoloop.studies.stress import STRESS
from glucoloop.studies.study import Study
from glucoloop.studies.tuning import TUNE
from glucoloop.studies.verification import VERIFY

STUDIES: Final[tuple[Study, ...]] = (TUNE, STRESS, DETECT, ADVERSARY, VERIFY)
