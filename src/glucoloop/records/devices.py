"""Kinds of devices, without what tells one device or person from another."""

from __future__ import annotations

import re
from typing import Final

import polars as pl

_KINDS: Final = tuple(
    (re.compile(pattern, re.IGNORECASE), kind)
    for pattern, kind in (
        (r"(?<![a-z0-9])G7|DexG7|Dexcom ?G7", "Dexcom G7"),
        (r"(?<![a-z0-9])G6|DexG6|Dexcom ?G6", "Dexcom G6"),
        (r"(?<![a-z0-9])G5|DexG5|Dexcom ?G5", "Dexcom G5"),
        (r"(?<![a-z0-9])G4|DexG4|Dexcom ?G4", "Dexcom G4"),
        (r"Stelo", "Dexcom Stelo"),
        (r"Dexcom ONE\+", "Dexcom ONE+"),
        (r"Dexcom ONE", "Dexcom ONE"),
        (r"Dexcom|^share\d?$", "Dexcom"),
        (r"Libre ?3 ?Plus", "FreeStyle Libre 3 Plus"),
        (r"Libre ?3", "FreeStyle Libre 3"),
        (r"Libre ?2 ?Plus", "FreeStyle Libre 2 Plus"),
        (r"Libre ?2", "FreeStyle Libre 2"),
        (r"Libre ?Pro", "FreeStyle Libre Pro"),
        (r"Libre ?Link", "FreeStyle LibreLink"),
        (r"Libre|Abbott", "FreeStyle Libre"),
        (r"Guardian ?Connect", "Guardian Connect"),
        (r"MiniMed ?(780G|770G|740G|720G|670G|640G|630G|530G)", "MiniMed {0}"),
        (r"MMT-\d+|MiniMed|Medtronic|Guardian|Paradigm", "Medtronic"),
        (r"tandem|t:slim|Control-IQ", "Tandem"),
        (r"Omnipod|Insulet|InsOmn", "Omnipod"),
        (r"Eversense|Senseonics", "Eversense"),
        (r"openaps", "OpenAPS"),
        (r"AndroidAPS|AAPS", "AndroidAPS"),
        (r"Trio", "Trio"),
        (r"iAPS|FreeAPS", "iAPS"),
        (r"(?<![a-z])Loop", "Loop"),
        (r"xDrip", "xDrip"),
    )
)


def kind_of(text: str | None, otherwise: str) -> str:
    """Kind of device that a text names; `otherwise` for one that is not known, of which nothing is passed on."""
    for pattern, kind in _KINDS:
        result = pattern.search(text or "")
        if result:
            return kind.format(*(group.upper() for group in result.groups()))
    return otherwise


def device_kinds(texts: pl.Series, otherwise: str) -> pl.Series:
    """Kind of device of each row."""
    each = texts.unique()
    kinds = [kind_of(text, otherwise) for text in each]
    table = pl.DataFrame({"text": each, "device": kinds}, schema={"text": pl.String, "device": pl.String})
    joined = pl.DataFrame({"text": texts}).join(table, on="text", how="left", nulls_equal=True, maintain_order="left")
    return joined["device"].alias("device")


_PROGRAMS: Final = tuple(
    (re.compile(pattern, re.IGNORECASE), name)
    for pattern, name in (
        (r"glooko", "Glooko"),
        (r"diasend", "Diasend"),
        (r"carelink", "CareLink"),
        (r"clarity", "Dexcom Clarity"),
        (r"libreview", "LibreView"),
        (r"t:connect|tandem source", "t:connect"),
        (r"tidepool", "Tidepool"),
        (r"nightscout", "Nightscout"),
        (r"mysugr", "mySugr"),
        (r"sidiary", "SiDiary"),
        (r"juggluco", "Juggluco"),
        (r"sibionics|sisensing", "Sibionics"),
        (r"linx|aidex", "LinX"),
        (r"caresens", "CareSens Air"),
        (r"camaps|mylife", "mylife"),
    )
)


def program_of(text: str) -> str | None:
    """Program or device that a text names; None for one that is not known."""
    named = next((name for pattern, name in _PROGRAMS if pattern.search(text)), None)
    return named or kind_of(text, "") or None
