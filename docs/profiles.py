"""Titrated profiles of people beside the rules of 500 and 1800: the range of 90 % of people."""

import numpy as np

from glucoloop.build.titration import Titration
from glucoloop.patients import patient, population, virtual_people

PEOPLE = {"hovorka-2004": "boiroux2017", "wilinska-2010": "wilinska2010"}
NUMBER = 512


def main():
    for family, name in PEOPLE.items():
        people = virtual_people(population(name, patient=family), 0, np.arange(NUMBER))
        titrated = Titration(patient(family), people.at(np.arange(1)).patient).profile(people)
        for what, own, rule in (
            ("carbohydrate ratio", titrated.carb_ratio_g_U, people.profile.carb_ratio()),
            ("correction factor", titrated.correction_mg_dl_U, people.profile.correction_factor()),
        ):
            low, middle, high = np.nanpercentile(own / np.asarray(rule), [5, 50, 95])
            known = int(np.isfinite(own).sum())
            print(f"{name}, {what} of {known} people: {low:.2f} to {high:.2f} times the rule's, median {middle:.2f}")


if __name__ == "__main__":
    main()
