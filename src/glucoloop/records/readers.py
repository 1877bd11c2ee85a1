"""Readers of records by name; each is one class in a file of its own."""

from __future__ import annotations

from typing import Final

from glucoloop.component.catalogue import Catalogue
from glucoloop.records.any_table import AnyTable
from glucoloop.records.carelink import CareLink
from glucoloop.records.dexcom_clarity import DexcomClarity
from glucoloop.records.libreview import LibreView
from glucoloop.records.nightscout import Nightscout
from glucoloop.records.ohio_t1dm import OhioT1DM
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.replaybg import ReplayBG
from glucoloop.records.simglucose import Simglucose
from glucoloop.records.tidepool import Tidepool

READERS: Final = Catalogue(
    ReaderComponent,
    (DexcomClarity, LibreView, CareLink, Nightscout, Tidepool, OhioT1DM, Simglucose, ReplayBG, AnyTable),
    example="dexcom-clarity",
)
