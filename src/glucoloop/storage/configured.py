"""Folder of a long computation with a configuration of flat keys; it resumes only with the same configuration.

The first file of the folder holds the configuration and the arithmetic of the results.
"""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final

import glucoloop
from glucoloop import arithmetic
from glucoloop.config.toml import read_toml, toml_text
from glucoloop.storage import disk
from glucoloop.storage.disk import SUMS
from glucoloop.storage.files import kept_text
from glucoloop.storage.resumable import Layout, ResumableFolder
from glucoloop.storage.strict_json import json_text

ARITHMETIC: Final = "arithmetic.json"


class ConfiguredFolder(ResumableFolder):
    """A folder of a computation with a configuration.

    Parameters
    ----------
    path : Path
    layout : Layout
        Layout whose first file is the configuration, and whose files include `ARITHMETIC`.
    command : str
        Name of the command that does the work.
    keys : mapping
        The configuration as flat keys.
    summary : str
        Name of the summary of the finished work.
    may_change : collection of str
        Keys of the extent of the work, in which it may differ from the earlier work in the folder.
    """

    def __init__(
        self,
        path: Path,
        layout: Layout,
        *,
        command: str,
        keys: Mapping[str, Any],
        summary: str,
        may_change: Collection[str] = (),
    ) -> None:
        super().__init__(path, layout)
        self._command, self._keys, self._summary, self._may_change = command, keys, summary, may_change

    @abstractmethod
    def read_done(self) -> None:
        """Read the results so far.

        Raises
        ------
        ValueError
            If they are damaged, or more than is asked for.
        """

    def finish(self, files: Mapping[str, bytes]) -> None:
        """Write the files about the whole work, the digests of all files last."""
        for name, data in files.items():
            self.put_file(name, data)
        names = (self.layout.first, ARITHMETIC, self.layout.done, *files)
        self.put_file(SUMS, disk.sums_text({name: disk.digest(self.path / name) for name in names}))

    def summary(self) -> dict[str, Any]:
        """The summary of finished work, as it was written."""
        found: dict[str, Any] = json.loads(kept_text(self.path / self._summary, f"the summary of a {self.layout.what}"))
        return found

    def create(self) -> None:
        """Write the configuration into the folder."""
        self._write_what()

    def load(self) -> None:
        """Read the results of the same work; if it was extended, its configuration is written again."""
        place = self.path / self.layout.first
        there, version = read_toml(kept_text(place, "a configuration"), str(place))
        self._refuse_another(there, version)
        self.read_done()
        if not self._is_whole(there):
            if self.anything_done:
                self._refuse_other_arithmetic()
            disk.remove(self.path / SUMS)
            self._write_what()

    def refuse_foreign_parts(self) -> None:
        """Accept the folder, since the results are one file that holds nothing else."""

    def _write_what(self) -> None:
        first = self.layout.first
        files = {
            first: toml_text(self._keys, f"{self._command} --config {first}").encode(),
            ARITHMETIC: (json_text(arithmetic.identity()) + "\n").encode(),
        }
        for name, data in files.items():
            if not (disk.is_file(self.path / name) and disk.read_bytes(self.path / name) == data):
                disk.put_file(self.path / name, data)

    def _refuse_another(self, there: Mapping[str, Any], version: str | None) -> None:
        if version != glucoloop.__version__:
            raise ValueError(
                f"{self.path} was begun by glucoloop {version}, and this is {glucoloop.__version__}; "
                f"go on with {version}, or choose another folder with --out"
            )
        here = {key: value for key, value in self._keys.items() if value is not None}
        for key in dict.fromkeys([*here, *there]):
            if key not in self._may_change and json_text(here.get(key)) != json_text(there.get(key)):
                before, now = (_shown(keys.get(key)) for keys in (there, here))
                raise ValueError(
                    f"{self.path} holds another {self.layout.what}: {key} is {before} there and {now} here; choose "
                    "another folder with --out, or add --overwrite to replace it"
                )

    def _refuse_other_arithmetic(self) -> None:
        try:
            there = json.loads(kept_text(self.path / ARITHMETIC, "a record of the arithmetic"))
            found = arithmetic.difference({name: str(of) for name, of in there.items()}, arithmetic.identity())
        except (ValueError, AttributeError, RecursionError):
            raise ValueError(
                f"{self.path / ARITHMETIC} is damaged or gone, so it is not known how what is done was computed; "
                "choose another folder with --out, or add --overwrite to begin again"
            ) from None
        if found is not None:
            name, before, now = found
            raise ValueError(
                f"{self.path} was computed with {name} {before}, and here it is {now}, which does not give the same "
                "bits; go on as before, choose another folder with --out, or add --overwrite to begin again"
            )

    def _is_whole(self, there: Mapping[str, Any]) -> bool:
        """Whether all results asked for are there; ValueError if a file was changed."""
        if not disk.is_file(self.path / SUMS):
            return False
        sums, layout = disk.read_sums(self.path), self.layout
        self.refuse_changed(sums)
        whole = all(name in layout.names and disk.is_file(self.path / name) for name in sums)
        complete = {layout.first, ARITHMETIC, layout.done} <= sums.keys()
        return whole and complete and all(there.get(key) == self._keys.get(key) for key in self._may_change)


def _shown(value: object) -> object:
    return "not given" if value is None else value
