"""Configuration of a command, complete and checked."""

from glucoloop.config.comparison import Comparison, read_comparison
from glucoloop.config.identification import IdentificationConfig, read_identification
from glucoloop.config.meal_text import meal_text, parse_meal
from glucoloop.config.population import named_population, population_keys, read_population
from glucoloop.config.run import CaseKeys, Run, SituationKeys, overlay, read_run
from glucoloop.config.sentences import one_sentence
from glucoloop.config.toml import read_toml, toml_text

__all__ = [
    "CaseKeys",
    "Comparison",
    "IdentificationConfig",
    "Run",
    "SituationKeys",
    "meal_text",
    "named_population",
    "one_sentence",
    "overlay",
    "parse_meal",
    "population_keys",
    "read_comparison",
    "read_identification",
    "read_population",
    "read_run",
    "read_toml",
    "toml_text",
]
