"""Kinds of devices and insulins by the words of people and apps, without what tells one person from another."""

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


_LONG_ACTING: Final = re.compile(
    r"(?i)long[ -]?acting|glar(?:ig|g)in|detemir|degludec|icodec|isophane|\bnph\b|lantus|toujeo|basaglar|abasaglar|"
    r"semglee|rezvoglar|lusduna|levemir|tresiba|awiqli|insulatard|protaphane?|protamine|humulin n\b|novolin n\b|"
    r"ultralente"
)


def is_long_acting(name: str) -> bool:
    """Whether a name is that of a long-acting or intermediate insulin, as ``Lantus`` or ``insulin degludec``.

    Examples
    --------
    >>> is_long_acting("Lantus"), is_long_acting("NovoRapid")
    (True, False)
    """
    return _LONG_ACTING.search(name) is not None


_MIX: Final = re.compile(r"(?i)(\d\d) ?/ ?(\d\d)|\bmix(?:tard)? ?(\d\d)|\b(\d\d) ?R\b")
"""Numbers in the name of a premixed insulin: intermediate and rapid-acting parts, or the latter alone."""


def rapid_share(name: str) -> float:
    """Share of an insulin that acts at once: 1 of a rapid-acting or regular one, 0 of a long-acting one.

    Examples
    --------
    >>> rapid_share("insulin aspart 70/30"), rapid_share("Novolin 50R"), rapid_share("insulin glargine")
    (0.3, 0.5, 0.0)
    """
    mix = _MIX.search(name)
    if mix is None:
        return 0.0 if is_long_acting(name) else 1.0
    first, second, *alone = mix.groups()
    if first is not None:
        return min(float(first), float(second)) / 100.0
    return float(next(number for number in alone if number)) / 100.0
