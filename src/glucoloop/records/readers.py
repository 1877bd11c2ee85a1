"""Readers of records: name of each, and the module that knows its files.

A reader is one module with two functions, ``recognised(content)`` and ``rows(content, answers)``, and one class,
entered in `READERS` or by the entry point of another package in the group ``glucoloop.readers``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Final

from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue
from glucoloop.component.code import loaded

if TYPE_CHECKING:
    from glucoloop.records.answers import Answers
    from glucoloop.records.extract import Extract
    from glucoloop.records.file_text import FileText


class ReaderComponent(Component):
    """Declaration of a reader of files of one kind."""

    kind: ClassVar = "reader"
    home: ClassVar[str] = ""
    """Module of its two functions."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file is one of its kind."""
        return bool(loaded(f"{self.home}:recognised")(content))

    def with_zone(self, content: FileText, answers: Answers) -> Answers | None:
        """Answers with what a file tells about the other files of a person; None for a file with rows of its own."""
        return None

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of a file, every one of them; Refusal where it leaves something open that was not given."""
        result: Extract = loaded(f"{self.home}:rows")(content, answers)
        return result


class DexcomClarity(ReaderComponent, name="dexcom-clarity"):
    """CSV that Dexcom Clarity exports."""

    home: ClassVar = "glucoloop.records.dexcom_clarity"


class LibreView(ReaderComponent, name="libreview"):
    """CSV that LibreView exports of a FreeStyle Libre."""

    home: ClassVar = "glucoloop.records.libreview"


class CareLink(ReaderComponent, name="carelink"):
    """CSV that CareLink exports of pumps and sensors of Medtronic."""

    home: ClassVar = "glucoloop.records.carelink"


class Nightscout(ReaderComponent, name="nightscout"):
    """JSON of entries or treatments of Nightscout, and of its profiles beside them."""

    home: ClassVar = "glucoloop.records.nightscout"

    def with_zone(self, content: FileText, answers: Answers) -> Answers | None:
        """Answers with the profiles that a file holds."""
        result: Answers | None = loaded(f"{self.home}:with_zone")(content, answers)
        return result


class Tidepool(ReaderComponent, name="tidepool"):
    """JSON that Tidepool exports."""

    home: ClassVar = "glucoloop.records.tidepool"


class OhioT1DM(ReaderComponent, name="ohio-t1dm"):
    """XML of the data set OhioT1DM."""

    home: ClassVar = "glucoloop.records.ohio_t1dm"


class Simglucose(ReaderComponent, name="simglucose"):
    """CSV of results of the simulator simglucose."""

    home: ClassVar = "glucoloop.records.simglucose"


class ReplayBG(ReaderComponent, name="replaybg"):
    """CSV of data of ReplayBG."""

    home: ClassVar = "glucoloop.records.replaybg"


class AnyTable(ReaderComponent, name="table"):
    """Any table whose columns are named, or have the names of a record."""

    home: ClassVar = "glucoloop.records.any_table"


READERS: Final = Catalogue(
    ReaderComponent,
    {
        "dexcom-clarity": "glucoloop.records.readers:DexcomClarity",
        "libreview": "glucoloop.records.readers:LibreView",
        "carelink": "glucoloop.records.readers:CareLink",
        "nightscout": "glucoloop.records.readers:Nightscout",
        "tidepool": "glucoloop.records.readers:Tidepool",
        "ohio-t1dm": "glucoloop.records.readers:OhioT1DM",
        "simglucose": "glucoloop.records.readers:Simglucose",
        "replaybg": "glucoloop.records.readers:ReplayBG",
        "table": "glucoloop.records.readers:AnyTable",
    },
    example="dexcom-clarity",
)
