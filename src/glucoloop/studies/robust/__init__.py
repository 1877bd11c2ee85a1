"""A tuning that holds for people and in noise: the search for it, and its check on others."""

from glucoloop.studies.robust.front import BOTH, Bound, choose, keeps, pareto
from glucoloop.studies.robust.loop import TuningLoop
from glucoloop.studies.robust.objectives import OBJECTIVES, Objective, objective, scores
from glucoloop.studies.robust.search import (
    AS_IT_WAS,
    CHOSEN,
    Candidate,
    Checked,
    Group,
    Search,
    SearchEngine,
    Verdict,
    bounds_of,
    judge,
)
from glucoloop.studies.robust.subjects import Subjects, draw_subjects
from glucoloop.tuning.samplers import SAMPLERS, Sampler, Told, make_sampler
from glucoloop.tuning.space import FURTHER, SPACE, Tuned, parse_range

__all__ = [
    "AS_IT_WAS",
    "BOTH",
    "CHOSEN",
    "FURTHER",
    "OBJECTIVES",
    "SAMPLERS",
    "SPACE",
    "Bound",
    "Candidate",
    "Checked",
    "Group",
    "Objective",
    "Sampler",
    "Search",
    "SearchEngine",
    "Subjects",
    "Told",
    "Tuned",
    "TuningLoop",
    "Verdict",
    "bounds_of",
    "choose",
    "draw_subjects",
    "judge",
    "keeps",
    "make_sampler",
    "objective",
    "pareto",
    "parse_range",
    "scores",
]
