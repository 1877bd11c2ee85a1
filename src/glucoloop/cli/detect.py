"""``glucoloop detect``: delay, certainty and accuracy of the estimates of meals that are not announced."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from glucoloop.cli.options import CASE, OF_OTHERS, OUTPUT, SETTINGS, Given, Option, names, reworded, with_options
from glucoloop.cli.request import split_off_output
from glucoloop.cli.screen import stage, stages
from glucoloop.cli.study import read_request, tell_results
from glucoloop.cli.trial_options import TRIAL
from glucoloop.registry.controllers import CONTROLLERS, ESTIMATING, all_settings

if TYPE_CHECKING:
    from glucoloop.studies.detection.detection import Detection

HELP: Final = (
    "Try the estimators of meals that nobody announced: how soon a meal is detected, how well its size is told, and "
    "how often there is a false alarm.\n\n"
    "Each day begins at rest and has meals and noise of its own, and as many days again are without a meal. Without "
    "options it is 100 days of one person, two meals a day of 11 to 99 g, noise of variance 1.45, and doses by "
    f"{ESTIMATING.name}, which rests on the estimator. Another controller, like basal, doses without it.\n\n"
    "  glucoloop detect --out detect\n\n"
    "  glucoloop detect --controller basal --estimator moving-horizon --threshold 0.8\n\n"
    "  glucoloop detect --population parker2000 --people 100 --meals-per-h 0.1 --out people\n\n"
    "  glucoloop detect --config detect/detect.toml"
)
_ESTIMATORS: Final = "Estimators"
_OF_A_TRIAL: Final = (
    *(
        "people",
        "population",
        "first_person",
        "meals",
        "meal_model",
        "no_meal",
        "meal_size_spread_pct",
        "meal_time_spread_min",
    ),
    *("patient", "operating_point", "setpoint_mg_dl", "noise_variance", "noise_bound_mg_dl", "dead_time_min", "site"),
    *("max_change_mU_min", "min_insulin_mU_min", "max_insulin_mU_min", "pump_resolution_mU_min"),
    *("faults", "no_fault", "sample_time_min", "seed", "allow_unusual", "known_dead_time"),
)
_DEFAULTS: Final = {
    "people": "1",
    "population": "nominal",
    "meals": "55g@5h, 55g@14.5h",
    "meal_size_spread_pct": "80",
    "meal_time_spread_min": "90",
    "noise_variance": "1.45",
}
_WORDS: Final = {"known_dead_time": "Whether controller and estimators know the dead time."}
_OWN: Final = (
    Option("days", "--days", int, "Days of each person.", "Meals", metavar="N", default="100; of several people 1"),
    Option(
        "estimators",
        "--estimator",
        list[str],
        f"{', '.join(ESTIMATING.setting('estimator').choices)}; repeat it for more.",
        _ESTIMATORS,
        metavar="NAME",
        default="both",
    ),
    Option(
        "threshold",
        "--threshold",
        float,
        "Probability of a meal above which it counts as detected.",
        _ESTIMATORS,
        metavar="P",
        default="0.5",
    ),
    Option(
        "controller",
        "--controller",
        str,
        f"Who doses: {', '.join(CONTROLLERS)}, {OF_OTHERS}.",
        "Controller",
        metavar="NAME",
        default=ESTIMATING.name,
    ),
)


def _controller_options() -> Iterator[Option]:
    """Settings of all controllers, those of the estimators in words of their own."""
    settings = {*all_settings(), SETTINGS} - {"estimator"}
    own = {name: ESTIMATING.setting(name) for name in ESTIMATING.estimator_settings}
    return reworded(
        (option for option in CASE if option.key in settings),
        help={name: setting.summary for name, setting in own.items()},
        default={name: setting.default.text for name, setting in own.items()},
        panel=dict.fromkeys(own, _ESTIMATORS),
    )


_OPTIONS: Final = (
    *reworded((option for option in TRIAL if option.key in _OF_A_TRIAL), help=_WORDS, default=_DEFAULTS),
    *_OWN,
    *_controller_options(),
    *OUTPUT,
)


@with_options(_OPTIONS)
def command(given: Given) -> None:
    """Check the request, run the test, write and print the results."""
    keys, output, file = split_off_output(given)
    if not keys.get("estimators"):
        keys.pop("estimators", None)
    files: dict[str, str] = {}
    with output.folder() as folder:
        asked = read_request(keys, file, _read)
        from glucoloop.studies.detection.evaluate import evaluate
        from glucoloop.studies.detection.results import files_of, notes, report
        from glucoloop.studies.detection.table import detection_table

        with stages("Designing and compiling") as done:
            result = evaluate(asked, done)
        if folder is not None:
            with stage("Drawing"):
                for name, data in files_of(asked, result).items():
                    folder.write(name, data)
            files = folder.paths()
    told = tuple(notes(asked, result))
    tell_results(output, report(asked, result), files, [detection_table(result)], told, notes=told)


def _read(keys: Given, of_file: Given) -> Detection:
    from glucoloop.config import overlay
    from glucoloop.studies.detection.keys import read_detection

    called = names(_OPTIONS, keys)
    if "people" in keys and "days" not in keys:
        of_file.pop("days", None)  # how many of each follows from how many there are
    return read_detection(overlay(of_file, keys, called), called)
