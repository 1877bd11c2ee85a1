"""All studies that are declared, in the order of the help."""

from __future__ import annotations

from typing import Final

from glucoloop.studies.bound import BOUND
from glucoloop.studies.robust import ROBUST
from glucoloop.studies.stress import STRESS
from glucoloop.studies.study import Study
from glucoloop.studies.tuning import TUNE
from glucoloop.studies.verification import VERIFY

STUDIES: Final[tuple[Study, ...]] = (BOUND, TUNE, ROBUST, STRESS, VERIFY)
