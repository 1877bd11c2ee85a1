"""``shard.json``: the trial and people of a shard, so that no shard is taken for another."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from glucoloop.cohorts.trial import FORMAT, Trial
from glucoloop.refusal import Refusal
from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS
from glucoloop.storage.files import kept_text
from glucoloop.storage.strict_json import json_text
from glucoloop.storage.trials.shard import bounds

SHARD: Final = "shard.json"
_KIND: Final = "glucoloop-shard"


def bound(trial: Trial, index: int, files: Mapping[str, bytes], *, fingerprint: str, arithmetic: str) -> bytes:
    """Record that ties the files of a shard to their trial.

    Parameters
    ----------
    trial : Trial
    index : int
    files : mapping
        Contents of the files by name.
    fingerprint : str
        Fingerprint of the trial.
    arithmetic : str
        Digest of the arithmetic on which the bits depend.

    Raises
    ------
    ValueError
        If the files are not those of such a shard, or have too many or too few rows.
    """
    expected = bounds(trial, index)
    if files.keys() != expected.keys():
        raise Refusal(f"shard {index} has the files {', '.join(files)}, and not {', '.join(expected)}")
    rows = {}
    for name, of_file in sorted(expected.items()):
        try:
            rows[name] = of_file.check(files[name])
        except ValueError as error:
            raise Refusal(f"{name} of shard {index} is not as it must be: {error}") from None
    person = trial.shard(index)
    told = {
        **_identity(index, fingerprint, arithmetic),
        "first_person": int(person[0]),
        "people": int(person.size),
        "rows": rows,
    }
    return (json_text(told) + "\n").encode()


def whole_shard(place: Path, folder: Path, index: int, *, fingerprint: str, arithmetic: str) -> dict[str, str]:
    """Digests of an undamaged shard of this trial.

    Raises
    ------
    ValueError
        If it is damaged, or belongs to another trial.
    """
    mend = f"delete {place} and run the same command again"
    try:
        disk.is_folder(place)
        sums = disk.read_sums(place)
        names = [name for name in disk.names(place) if name != SUMS]
        changed = [name for name in sums if disk.digest(place / name) != sums[name]]
        if SHARD not in sums or names != sorted(sums):
            changed.append(SUMS)
    except ValueError as error:
        raise Refusal(f"shard {place.name} of {folder} is damaged: {str(error).partition(';')[0]}; {mend}") from None
    if changed:
        raise Refusal(f"shard {place.name} of {folder} is damaged: {changed[0]} is not as it was written; {mend}")
    told = _told(place / SHARD)
    for name, value in _identity(index, fingerprint, arithmetic).items():
        if told.get(name) != value:
            raise Refusal(
                f"shard {place.name} of {folder} belongs to something else: its {name} is {told.get(name)}, and that "
                f"of its place is {value}; {mend}"
            )
    rows = told.get("rows")
    if not isinstance(rows, dict) or sorted([SHARD, *rows]) != names:
        raise Refusal(f"shard {place.name} of {folder} is damaged: {SHARD} does not list its files; {mend}")
    return sums


def _identity(index: int, fingerprint: str, arithmetic: str) -> dict[str, Any]:
    return {
        "format": _KIND,
        "format_version": FORMAT,
        "fingerprint": fingerprint,
        "arithmetic": arithmetic,
        "index": index,
    }


def _told(place: Path) -> dict[str, Any]:
    try:
        found = json.loads(kept_text(place, "the record of a shard"))
    except (ValueError, RecursionError):
        found = None
    return found if isinstance(found, dict) else {}
