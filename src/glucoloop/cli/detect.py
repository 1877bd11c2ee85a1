"""``glucoloop detect``: delay, certainty and accuracy of the estimates of meals that are not announced."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from glucoloop.cli.options import (
    CASE,
    OUTPUT,
    SETTINGS,
    Given,
    Option,
    among,
    names,
    options_of,
    reworded,
    with_options,
    without,
)
from glucoloop.cli.request import split_off_output
from glucoloop.cli.screen import stage, stages
from glucoloop.cli.study import read_request, tell_results
from glucoloop.cli.trial_options import TRIAL, usual_texts
from glucoloop.control.catalogue import ESTIMATING, all_settings
from glucoloop.studies.detection.options import ESTIMATORS_PANEL, TAKEN, USUAL, DetectionKeys

if TYPE_CHECKING:
    from glucoloop.studies.detection.detection import Detection

HELP: Final = (
    "Test the estimators of meals that nobody announced: how soon a meal is detected, how exactly its size is "
    "estimated, and how often there is a false alarm.\n\n"
    "Each day begins at rest and has its own meals and noise; the same number of days is without a meal. By default "
    "100 days of one person are simulated, with two meals a day of 11 to 99 g, noise of variance 1.45, and doses by "
    f"{ESTIMATING.name}, which uses the estimator. Other controllers, such as basal, do not use it.\n\n"
    "  glucoloop detect --out detect\n\n"
    "  glucoloop detect --controller basal --estimator moving-horizon --threshold 0.8\n\n"
    "  glucoloop detect --population parker2000 --people 100 --meals-per-h 0.1 --out people\n\n"
    "  glucoloop detect --config detect/detect.toml"
)
_NO_OPTIONS: Final = ("carb_error_pct", "carb_bias_pct")
"""Keys that concern announced meals."""


def _controller_options() -> Iterator[Option]:
    """Settings of all controllers, those of the estimators in words of their own."""
    settings = {*all_settings(), SETTINGS} - {"estimator"}
    own = {name: ESTIMATING.setting(name) for name in ESTIMATING.estimator_settings}
    return reworded(
        among(CASE, settings),
        help={name: setting.summary for name, setting in own.items()},
        default={name: setting.default.text for name, setting in own.items()},
        panel=dict.fromkeys(own, ESTIMATORS_PANEL),
    )


_OPTIONS: Final = (
    *reworded(
        without(among(TRIAL, TAKEN), *_NO_OPTIONS),
        help={"known_dead_time": "Whether controller and estimators know the dead time."},
        default=usual_texts(USUAL),
    ),
    *options_of(DetectionKeys),
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
        asked = read_request(keys, file, _read, _used)
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


def _used(asked: Detection) -> Given:
    from glucoloop.studies.detection.keys import detection_keys

    return detection_keys(asked)


def _read(keys: Given, of_file: Given) -> Detection:
    from glucoloop.config.run import overlay
    from glucoloop.studies.detection.keys import read_detection

    called = names(_OPTIONS, keys)
    return read_detection(overlay(of_file, keys, called), called)
