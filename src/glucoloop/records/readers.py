"""Readers of records by name; each is one class."""

from __future__ import annotations

from typing import Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.records.reader import ReaderComponent

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
