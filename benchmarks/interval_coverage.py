"""Coverage of the intervals of paired differences, where the truth is known.

    python benchmarks/interval_coverage.py FOLDER [--trials 1000] [--seed 1]

FOLDER is that of a trial of many people and at least two controllers. Its people are the population: trials of 20 to
1 000 of them are drawn with replacement, and the share of their 95 % intervals that hold the difference of the whole
population is printed, beside that of the percentiles of a bootstrap, and the share that have an interval at all.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import polars as pl

from glucoloop.trials.people import PeopleRows
from glucoloop.trials.statistics import PairedDifferences

METRICS = ("time_70_180_pct", "time_above_250_pct", "time_below_70_pct", "time_below_54_pct", "mean_mg_dl")
LIMITS = (70, 54)
PEOPLE = (20, 50, 200, 1000)
RESAMPLES = 1000
LARGEST_BOOTSTRAP = 200
FEWEST_SHARE = 0.05
"""Share of the trials with an interval below which nothing is said of it."""


def rows(table: pl.DataFrame, index: np.ndarray) -> PeopleRows:
    """Some people of a case."""
    metrics = {name: table[name].to_numpy()[index] for name in (*METRICS, "minimum_mg_dl")}
    everybody = np.ones(index.size, bool)
    return PeopleRows(np.arange(index.size), everybody, np.zeros(index.size), {}, metrics)


def paired(first: pl.DataFrame, other: pl.DataFrame, index: np.ndarray) -> dict:
    """Differences of two cases over some people, as plain values by name."""
    differences = PairedDifferences(LIMITS)
    of_first = rows(first, index)
    differences.add(of_first, rows(other, index), of_first.feasible)
    plain = differences.plain()
    return {**{name: plain["metrics"][name] for name in METRICS}, **plain["ever_below"]}


def main() -> None:
    """Print the coverage by metric and number of people."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    people = pl.concat([pl.read_parquet(path) for path in sorted(given.folder.glob("shards/*/people.parquet"))])
    cases = people["controller"].unique(maintain_order=True).to_list()
    first, other = (people.filter("able", controller=label) for label in cases[:2])
    truth = paired(first, other, np.arange(first.height))
    rng = np.random.default_rng(given.seed)
    print(f"{cases[1]} less {cases[0]}, {first.height} people, {given.trials} trials each\n")
    print("| | difference | " + " | ".join(f"{number} people" for number in PEOPLE) + " |")
    print("| :--- | ---: |" + " ---: |" * len(PEOPLE))
    cells: dict[str, list[str]] = {name: [] for name in truth}
    for number in PEOPLE:
        drawn = [paired(first, other, rng.integers(0, first.height, number)) for _ in range(given.trials)]
        for name, true in truth.items():
            having = [of[name] for of in drawn if np.isfinite(of[name]["low"])]
            held = sum(of["low"] <= true["mean"] <= of["high"] for of in having)
            share = len(having) / given.trials
            of_share = "" if share == 1.0 else f" ({100.0 * share:.0f} % have one)"
            rare = share < FEWEST_SHARE
            cells[name].append("hardly any has one" if rare else f"{100.0 * held / len(having):.1f}{of_share}")
            if name in METRICS and number <= LARGEST_BOOTSTRAP:
                difference = (other[name] - first[name]).to_numpy()
                by_bootstrap = bootstrap(difference, number, given.trials, rng)
                cells[name][-1] += f"; {by_bootstrap:.1f}"
    for name, texts in cells.items():
        head = name if name in METRICS else f"people ever below {name.removesuffix('_mg_dl')} mg/dl"
        print(f"| {head.replace('_', ' ')} | {truth[name]['mean']:+.2f} | " + " | ".join(texts) + " |")


def bootstrap(difference: np.ndarray, number: int, trials: int, rng: np.random.Generator) -> float:
    """Share of the intervals between percentiles of a bootstrap that hold the mean, in percent."""
    held = 0
    for _ in range(trials):
        drawn = rng.choice(difference, number)
        means = drawn[rng.integers(0, number, (RESAMPLES, number))].mean(axis=1)
        low, high = np.quantile(means, (0.025, 0.975))
        held += low <= difference.mean() <= high
    return 100.0 * held / trials


if __name__ == "__main__":
    main()
