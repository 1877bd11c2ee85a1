"""CSV of LibreView, of sensors FreeStyle Libre, in any language.

The first line is about the export, the next one with fields names the columns, which stand in the same order in every
language: device, serial number, time, type of the row, stored reading, scan, rapid-acting insulin without and with a
number, food, carbohydrate in grams and in portions, long-acting insulin, and so on. A type of 0 is a reading that the
sensor stores every 5 or 15 min, 1 a scan, 2 a strip, 4 insulin, 5 food, 6 anything else. Dates have the day or the
month first, depending on the country of the account. Sensors read from 40 to 500 mg/dl.
"""

from __future__ import annotations

from typing import Final

import polars as pl

from glucoloop.records.answers import UNITS, Answers
from glucoloop.records.devices import device_kinds
from glucoloop.records.extract import Extract, extract_frame
from glucoloop.records.file_text import FileText, LocalisedTable
from glucoloop.records.reader import ReaderComponent
from glucoloop.records.times import times_of

_HEADERS: Final = (
    ("Device Timestamp", "Record Type", "Historic Glucose"),
    ("Gerätezeitstempel", "Aufzeichnungstyp", "Glukosewert-Verlauf"),
    ("Horodatage de l'appareil", "Type d'enregistrement", "Historique de la glycémie"),
    ("Marca de hora del dispositivo", "Tipo de registro", "Historial de glucosa"),
    ("Sello de tiempo del dispositivo", "Tipo de registro", "Historial de glucosa"),
    ("Timestamp del dispositivo", "Storico del glucosio"),
    ("Tijdstempel apparaat", "Gegevenstype", "Historische glucose"),
    ("Tijdstempel meter", "Gegevenstype", "Historische glucose"),
    ("Carimbo de data/hora do dispositivo", "Histórico de glicose"),
    ("Znacznik czasu w urządzeniu", "Rodzaj zapisu", "Historyczne stężenia glukozy"),
    ("Enhetens tidsstämpel", "Registertyp", "Historiskt glukosvärde"),
    # the program for a computer that was there before LibreView
    ("ID", "Time", "Record Type", "Historic Glucose"),
    ("ID", "Hora", "Tipo de registro", "Histórico glucosa"),
)
_NAMES: Final = {
    "device": ("Device", "Gerät", "Appareil", "Dispositivo", "Apparaat", "Meter", "Enhet"),
    "serial": ("Serial Number", "Seriennummer", "Numéro de série", "Número de seri", "Serienummer"),
    "time": (
        *(header[0] for header in _HEADERS if header[0] != "ID"),
        *(header[1] for header in _HEADERS if header[0] == "ID"),
    ),
    "type": tuple(dict.fromkeys(header[-2] for header in _HEADERS if len(header) > 2)),
    "historic": tuple(dict.fromkeys(header[-1] for header in _HEADERS)),
    "scan": (
        "Scan Glucose",
        "Glukose-Scan",
        "Numérisation de la glycémie",
        "Scan de glycémie",
        "Escanear glucosa",
        "Escaneo de glucosa",
        "Glucosa leída",
        "Analisar glicose",
        "Stężenie glukozy na podstawie skanowania",
        "Skanna glukosvärde",
    ),
    "rapid": (
        "Rapid-Acting Insulin (",
        "Schnellwirkendes Insulin (",
        "Insuline à action rapide (",
        "Insulina de acción rápida (",
        "Insulina ad azione rapida (",
        "Snelwerkende insuline (",
        "Insulina de ação rápida (",
        "Snabbverkande insulin (",
    ),
    "slow": (
        "Long-Acting Insulin Value",
        "Long-Acting Insulin (",
        "Depotinsulin (",
        "Insuline à action longue (",
        "Insuline à action lente (",
        "Insulina de acción larga (",
        "Insulina de acción prolongada (",
        "Insulina de acción lenta (",
        "Insulina ad effetto prolungato (",
        "Langwerkende insuline (",
        "Insulina de ação prolongada (",
        "Långtidsverkande insulin (",
    ),
    "carbs": (
        "Carbohydrates (grams)",
        "Kohlenhydrate (Gramm)",
        "Glucides (grammes)",
        "Carbohidratos (gramos)",
        "Carboidrati (grammi)",
        "Koolhydraten (gram)",
        "Carboidratos (gramas)",
        "Kolhydrater (gram)",
    ),
}
_PLACES: Final = {
    "device": 0,
    "serial": 1,
    "time": 2,
    "type": 3,
    "historic": 4,
    "scan": 5,
    "rapid": 7,
    "carbs": 9,
    "slow": 12,
}
"""Place of each column where its word in a language is not known here."""
_FEWEST_FIELDS: Final = 14
_HISTORIC, _SCAN, _INSULIN, _FOOD = "0", "1", "4", "5"
_TYPES: Final = tuple("0123456")
_KINDS: Final = {"2": "strips", "3": "entries of other kinds", "6": "notes and other entries"}


def _place_by_form(content: FileText) -> tuple[int, str] | None:
    """Place of a header in any language: stored readings beside scans, both with the unit, and rows of types."""
    for place, fields in content.fields:
        if len(fields) < _FEWEST_FIELDS or not all(any(unit in text for unit in UNITS) for text in fields[4:6]):
            continue
        number, delimiter = place
        rows = [line.split(delimiter) for line in content.head[number + 1 :] if line.strip()][:5]
        if rows and all(
            len(row) > _PLACES["type"] and row[3].strip().strip('"') in _TYPES for row in rows[:-1] or rows
        ):
            return place
    return None


_FORM: Final = LocalisedTable(
    _HEADERS, _NAMES, _PLACES, _place_by_form, "historic", "LibreView, Device Timestamp, Record Type"
)


class LibreView(ReaderComponent, name="libreview"):
    """CSV that LibreView exports of a FreeStyle Libre."""

    def recognised(self, content: FileText) -> bool:
        """Whether a file has the header of LibreView."""
        return _FORM.recognised(content)

    def rows(self, content: FileText, answers: Answers) -> Extract:
        """Rows of an export of LibreView."""
        read = _FORM.rows(content)
        frame = read.frame
        times, notes = times_of(frame["time"], answers)
        kind = pl.col("type")
        keep_scans = answers.scans or not frame.filter(kind == _HISTORIC)["historic"].is_not_null().any()
        no_value = (
            pl.when((kind == _SCAN) & (not keep_scans))
            .then(pl.lit("scans, beside the readings that the sensor stores"))
            .when(kind == _INSULIN)
            .then(pl.lit("doses of insulin without a number"))
            .when(kind == _FOOD)
            .then(pl.lit("meals without grams of carbohydrate"))
            .when(~kind.is_in((_HISTORIC, _SCAN)))
            .then(kind.replace_strict(_KINDS, default="rows of an unknown type", return_dtype=pl.String))
            .when((kind == _SCAN) & keep_scans)
            .then(pl.lit("scans without a reading"))
        )
        glucose = pl.when(kind == _HISTORIC).then("historic").when((kind == _SCAN) & keep_scans).then("scan")
        return Extract(
            frame=extract_frame(
                frame,
                times,
                read.table.spoilt,
                glucose=glucose,
                carbs=pl.when(kind == _FOOD).then("carbs"),
                bolus=pl.when(kind == _INSULIN).then("rapid"),
                long_acting=pl.when(kind == _INSULIN).then("slow"),
                device=pl.lit(device_kinds(frame["device"], "FreeStyle Libre")),
                source=pl.concat_str("device", "serial", separator="|", ignore_nulls=True),
                kind=no_value,
            ),
            glucose_unit=read.glucose_unit,
            notes=(*read.notes, *notes),
            limits_mg_dl=(40.0, 500.0),
        )
