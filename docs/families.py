"""Run each command on a patient of each family, and write the table that ``guide/patients.md`` shows.

    python docs/families.py                    # every patient: half an hour on two idle processors
    python docs/families.py wilinska-2010      # this patient alone; the other columns stay

It rewrites ``guide/families.md`` after each command. Each cell is what came of one short run of the command; a command
that fails stops the script.
"""

import json
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from made import made

DOCS = Path(__file__).resolve().parent
PATIENTS = ("parker-1999", "hovorka-2004", "wilinska-2010", "uva-padova-2008", "kanderian-2009", "bergman:Minimal")


def _of_run(result):
    return f"undershoot {result['metrics']['undershoot_mg_dl']:.1f} mg/dl"


def _of_comparison(result):
    numbers = (f"{case['metrics']['undershoot_mg_dl']:.1f}" for case in result["cases"].values())
    return f"undershoot {' and '.join(numbers)} mg/dl"


def _of_identification(result):
    return f"gain {result['fit']['gain_mg_dl_per_mU_min']:.2f} mg/dl per mU/min"


def _of_tuning(result):
    return f"smallest sum of squares {result['best']['sse']:.4g}"


def _of_trial(result):
    return f"undershoot {result['controllers']['pid']['metrics']['undershoot_mg_dl']['median']:.1f} mg/dl, median"


def _of_stress(result):
    return f"lowest {min(row['lowest_mg_dl'] for row in result['rows']):.1f} mg/dl"


def _of_verification(result):
    return f"{sum(result['violations'].values())} violations in {result['samples']} samples"


def _of_detection(result):
    score = result["estimators"]["moving-horizon"]
    return f"{score['detected_pct']:.0f} % of {score['meals']} meals detected"


def _of_bound(result):
    return f"largest deviation {result['bounds'][0]['deviation_mg_dl']:.2f} mg/dl"


def _of_robust_search(result):
    scores = result["chosen"]["scores"]
    return f"undershoot {scores['undershoot_median_mg_dl']:.1f} mg/dl with the tuning chosen of {result['candidates']}"


def _of_adversary(result):
    return f"lowest {result['searches'][0]['lowest_mg_dl']:.1f} mg/dl"


# The command with its arguments, and what is said of its JSON object.
COMMANDS = {
    "run": ("--controller pid", _of_run),
    "compare": ("--controller pid --controller imc", _of_comparison),
    "identify": ("", _of_identification),
    "tune": ("--controller 'mpc, move_horizon=1:2, prediction_horizon=30:40:10'", _of_tuning),
    "trial": ("--people 8 --controller pid --out OUT", _of_trial),
    "stress": ("--people 2 --controller pid --fault missing --out OUT", _of_stress),
    "verify": ("--loops 8 --controller pid", _of_verification),
    "detect": ("--people 2", _of_detection),
    "bound": ("", _of_bound),
    "robust": (
        "--people 4 --check-people 4 --seeds 2 --check-seeds 2 --rounds 1 --batch 8 --out OUT",
        _of_robust_search,
    ),
    "adversary": ("--controller pid --people 2 --error 10 --generations 1 --out OUT", _of_adversary),
}


def carried_out(command, arguments, patient, folder):
    """The JSON object that a command prints; ends the script with what it said if it fails."""
    given = shlex.split(arguments.replace("OUT", str(folder / f"{command}-out")))
    words = [command, "--patient", patient, *given, "--json"]
    done = subprocess.run(["glucoloop", *words], cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"glucoloop {' '.join(words)} ended with {done.returncode}:\n{done.stderr}")
    return json.loads(done.stdout)


def cell(command, patient):
    arguments, said_of = COMMANDS[command]
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(DOCS.parent / "examples" / "bergman.py", folder)
        said = said_of(carried_out(command, arguments, patient, Path(folder)))
    print(f"{command}, {patient}: {said}", flush=True)
    return said


def cells_of(page):
    """The cells of a table that was written before, by command and patient."""
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| `")]
    head = next((line for line in page.splitlines() if line.startswith("| Command")), "| Command")
    patients = [name.strip("` ") for name in head.strip("| ").split(" | ")[1:]]
    return {
        (name.strip("`"), patient): said for name, *cells in rows for patient, said in zip(patients, cells, strict=True)
    }


def written(command):
    """The command as it was run, without the patient."""
    return f"glucoloop {command} {COMMANDS[command][0].replace('OUT', f'{command}-kept')}".strip()


def table(cells):
    """The page: a row for each command, in which a cell that was never made is empty."""
    lines = [
        f"| Command | {' | '.join(f'`{patient}`' for patient in PATIENTS)} |",
        f"| :--- |{' :--- |' * len(PATIENTS)}",
        *(
            f"| `{command}` | {' | '.join(cells.get((command, patient), '') for patient in PATIENTS)} |"
            for command in COMMANDS
        ),
        "",
        "The commands, each with `--patient`:",
        "",
        "```",
        *map(written, COMMANDS),
        "```",
        "",
        f"The cells were {made()}.",
        "",
    ]
    return "\n".join(lines)


def main():
    unknown = set(sys.argv[1:]) - set(PATIENTS)
    if unknown:
        sys.exit(f"{', '.join(sorted(unknown))} has no column; the columns are: {', '.join(PATIENTS)}")
    page = DOCS / "guide" / "families.md"
    cells = cells_of(page.read_text(encoding="utf-8")) if page.exists() else {}
    for command in COMMANDS:
        for patient in sys.argv[1:] or PATIENTS:
            cells[command, patient] = cell(command, patient)
            page.write_text(table(cells), encoding="utf-8")


if __name__ == "__main__":
    main()
