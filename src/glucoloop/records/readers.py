"""Readers of records by name; each is one class in a file of its own."""

from __future__ import annotations

from typing import Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.records.reader import ReaderComponent

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
