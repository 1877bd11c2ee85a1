"""Readers of files by name, and the classes of which every one is."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Final

from glucoloop.component.base import Component
from glucoloop.component.catalogue import Catalogue
from glucoloop.refusal import Refusal

if TYPE_CHECKING:
    from glucoloop.records.answers import Answers
    from glucoloop.records.extract import Extract
    from glucoloop.records.file_text import CellTable, FileText


Header = tuple[str, ...]
"""Names of fields that stand in one line of a file."""


class ReaderComponent(Component):
    """Reader of files of one kind: a class in a file of its own, entered in `READERS`.

    A package of your own enters it by an entry point in the group ``glucoloop.readers``.
    """

    kind: ClassVar = "reader"
    in_parts: ClassVar[bool] = False
    """Whether what it reads of a person comes as several files, of which one alone has the readings."""
    in_exports: ClassVar[bool] = False
    """Whether all files of a folder are the export of one person, however many have readings."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file is one of its kind."""
        raise NotImplementedError

    def with_profiles(self, content: FileText, answers: Answers) -> Answers | None:
        """Answers with what a file holds about the others of a person; None for a file with rows of its own."""
        return None

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of a file, every one of them; Refusal where it leaves something open that was not given."""
        raise NotImplementedError


class TableReaderComponent(ReaderComponent):
    """Reader of tables that are recognised by the names in their header."""

    headers: ClassVar[tuple[Header, ...]] = ()
    """Names in the header of each table of its kind."""
    whole: ClassVar[bool] = True
    """Whether fields of a header are these names; else they begin with them."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file has one of the headers."""
        return any(content.header(*names, whole=self.whole) for names in self.headers)

    def table(self, content: FileText) -> tuple[Header, CellTable]:
        """Names of the header that a file has, and its table; Refusal where it has none of them."""
        for names in self.headers:
            place = content.header(*names, whole=self.whole)
            if place is not None:
                return names, content.table(place)
        raise Refusal(
            f"it has no header of the reader {self.name}, as {', '.join(self.headers[0])}; "
            "give the file as it was exported or published"
        )


READERS: Final = Catalogue(
    ReaderComponent,
    {
        "dexcom-clarity": "glucoloop.records.dexcom_clarity:DexcomClarity",
        "libreview": "glucoloop.records.libreview:LibreView",
        "carelink": "glucoloop.records.carelink:CareLink",
        "carelink-raw": "glucoloop.records.carelink_raw:CareLinkRaw",
        "glooko": "glucoloop.records.glooko:Glooko",
        "diasend": "glucoloop.records.diasend:Diasend",
        "tandem": "glucoloop.records.tandem:Tandem",
        "nightscout": "glucoloop.records.nightscout:Nightscout",
        "tidepool": "glucoloop.records.tidepool:Tidepool",
        "xdrip": "glucoloop.records.xdrip:XDrip",
        "juggluco": "glucoloop.records.juggluco:Juggluco",
        "apple-health": "glucoloop.records.apple_health:AppleHealth",
        "jaeb": "glucoloop.records.jaeb:Jaeb",
        "ohio-t1dm": "glucoloop.records.ohio_t1dm:OhioT1DM",
        "azt1d": "glucoloop.records.azt1d:AZT1D",
        "t1d-uom": "glucoloop.records.t1d_uom:T1dUom",
        "hupa-ucm": "glucoloop.records.hupa_ucm:HupaUcm",
        "shanghai-t1dm": "glucoloop.records.shanghai_t1dm:ShanghaiT1DM",
        "simglucose": "glucoloop.records.simulators:Simglucose",
        "replaybg": "glucoloop.records.simulators:ReplayBG",
        "table": "glucoloop.records.any_table:AnyTable",
    },
    example="dexcom-clarity",
)
