"""``glucoloop identify``: a model from a pulse experiment on the virtual patient, or from a record."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Final

from glucoloop.cli.command import Command
from glucoloop.cli.option import OUTPUT, SHORT, Given, options_of, without
from glucoloop.cli.request import Output, completed, request_of
from glucoloop.cli.screen import stage
from glucoloop.cli.study import tell_results
from glucoloop.situations.request import asked_for, read_root
from glucoloop.storage.strict_json import with_version
from glucoloop.studies.identification import ModelRequest

if TYPE_CHECKING:
    from glucoloop.storage.folder import OutputFolder
    from glucoloop.studies.identified import Identified

HELP: Final = (
    "Identify a step-response model, which `glucoloop run --model` uses.\n\n"
    "Without --data the virtual patient gets the paper's insulin test, a pulse up and a pulse down, and the model is "
    "checked on a random binary sequence. With --data the model comes from your record: a CSV file whose first line "
    "names t_min, insulin_mU_min, glucose_mg_dl and, where something was eaten, carbs_g. A rate lasts until the next "
    "row (1 U/h is 16.67 mU/min; a bolus of 1 U over a row of 5 min is 200 mU/min more); an empty reading is missing. "
    "If the record does not say enough about insulin for a model to be used, the answer says so, and why.\n\n"
    "  glucoloop identify --noise 1.45 --out model\n\n"
    "  glucoloop identify --data record.csv --out model\n\n"
    "  glucoloop run --model model/model.json"
)
_OPTIONS: Final = (*without(options_of(ModelRequest), ModelRequest.refused), *SHORT, *OUTPUT)


def _identify(typed: Given) -> None:
    """Check the request, identify, write the model and report on it."""
    request = request_of(typed, _OPTIONS)
    read_root(ModelRequest, request.tree)
    output, files = request.output, dict[str, str]()
    with output.folder() as folder:
        asked: ModelRequest = completed(request, functools.partial(asked_for, ModelRequest))
        from glucoloop.studies.identified import identify

        with stage("Identifying a model"):
            identified = identify(asked)
        if folder is not None:
            with stage("Drawing"):
                _write(folder, identified)
            files = folder.paths()
    _tell(identified, output, files)


def _write(folder: OutputFolder, identified: Identified) -> None:
    from glucoloop.report import plot_identification, plot_validation
    from glucoloop.report.print_figure import figure_files
    from glucoloop.situations.toml import toml_text
    from glucoloop.storage import tables
    from glucoloop.storage.strict_json import json_text

    folder.write("model.json", identified.model.text())
    folder.write("record.csv", tables.csv(tables.record_table(identified.record)))
    folder.write("fit.json", json_text(with_version(identified.report())) + "\n")
    response = plot_identification(identified.identification, truth=identified.truth)
    validation = plot_validation(
        identified.validation,
        sample_time_min=identified.record.sample_time_min,
        insulin_deviation_mU_min=identified.validation_insulin_mU_min,
        title=identified.validated_on.capitalize(),
    )
    for name, data in {**figure_files("response", response), **figure_files("validation", validation)}.items():
        folder.write(name, data)
    copied = {}
    if identified.data is not None:
        folder.write("data.csv", identified.data)
        copied = {"data": "data.csv"}
    used, given = identified.config.tree(whole=True), identified.config.tree()
    text = toml_text({**used, **copied}, "identify --config identify.toml", {**given, **copied})
    folder.write("identify.toml", text)


def _tell(identified: Identified, output: Output, files: dict[str, str]) -> None:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("Model")
    table.add_column("Value", justify="right")
    table.add_column("Unit")
    for name, value, unit in identified.rows():
        table.add_row(name, value, unit)
    notes, warning = identified.notes, _warning(identified)
    tell_results(output, identified.report(), files, [table], notes, notes=(*notes, *warning))
    if output.json:
        return
    for line in warning:
        print(line)
    if "model.json" in files and not identified.model.doubts():
        print(f"Use it: glucoloop run --model {files['model.json']}{identified.run_hint}")


def _warning(identified: Identified) -> tuple[str, ...]:
    """Lines of warning about a model on which no controller should be designed."""
    reasons = identified.model.doubts()
    if not reasons:
        return ()
    mend = "record for longer, or change insulin more, and more often, than meals and noise change glucose"
    if identified.config.data is None:
        mend = "lengthen the experiment with --samples, or give a lower --noise"
    elif any((identified.config.memory, identified.config.laguerre_pole, identified.config.laguerre_functions)):
        mend = (
            f"leave out --memory, --laguerre-pole and --laguerre-functions, so that the record chooses them; or {mend}"
        )
    return ("DO NOT USE THIS MODEL for a controller; `glucoloop run` refuses it.", *reasons, f"To mend it, {mend}.")


IDENTIFY: Final = Command("identify", HELP, _OPTIONS, _identify)
