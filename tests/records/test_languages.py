"""Exports in the language of their owner: by the words of their header, or by the place of their columns."""

import re

import pytest

from device_files import CARELINK_HEADER, START, carelink, clarity, every, glucose
from record_values import notes_of, reading_times

LIBRE_HEADERS = {
    "French": "Appareil,Numéro de série,Horodatage de l'appareil,Type d'enregistrement,Historique de la glycémie mg/dL,"
    "Numérisation de la glycémie mg/dL,Insuline à action rapide sans valeur numérique,"
    "Insuline à action rapide (unités),Alimentation sans valeur numérique,Glucides (grammes),Glucides (portions),"
    "Insuline à action longue sans valeur numérique,Insuline à action longue (unités)",
    "Spanish": "Dispositivo,Número de serie,Marca de hora del dispositivo,Tipo de registro,Historial de glucosa mg/dL,"
    "Escanear glucosa mg/dL,Insulina de acción rápida sin valor numérico,Insulina de acción rápida (unidades),"
    "Alimentos sin valor numérico,Carbohidratos (gramos),Carbohidratos (raciones),"
    "Insulina de acción prolongada sin valor,Insulina de acción prolongada (unidades)",
    "Spanish of America": "Dispositivo,Número de serial,Sello de tiempo del dispositivo,Tipo de registro,"
    "Historial de glucosa mg/dL,Escaneo de glucosa mg/dL,Insulina de acción rápida no numérica,"
    "Insulina de acción rápida (unidades),Alimento no numérico,Carbohidratos (gramos),Carbohidratos (porciones),"
    "Insulina de acción larga no numérica,Insulina de acción larga (unidades)",
    "Italian": "Dispositivo,a,Timestamp del dispositivo,b,Storico del glucosio mg/dL,c mg/dL,d,"
    "Insulina ad azione rapida (unità),e,Carboidrati (grammi),f,g,Insulina ad effetto prolungato (unità)",
    "Dutch": "Apparaat,Serienummer,Tijdstempel apparaat,Gegevenstype,Historische glucose mg/dL,Scan Glucose mg/dL,"
    "Niet-numerieke snelwerkende insuline,Snelwerkende insuline (eenheden),Niet-numeriek voedsel,Koolhydraten (gram),"
    "Koolhydraten (porties),Niet-numerieke langwerkende insuline,Langwerkende insuline (eenheden)",
    "Portuguese": "Dispositivo,a,Carimbo de data/hora do dispositivo,b,Histórico de glicose mg/dL,"
    "Analisar glicose mg/dL,c,Insulina de ação rápida (unidades),d,Carboidratos (gramas),e,f,"
    "Insulina de ação prolongada (unidades)",
    "Polish": "a,b,Znacznik czasu w urządzeniu,Rodzaj zapisu,Historyczne stężenia glukozy mg/dL,"
    "Stężenie glukozy na podstawie skanowania mg/dL,c,d,e,f,g,h,i",
    "Swedish": "Enhet,Serienummer,Enhetens tidsstämpel,Registertyp,Historiskt glukosvärde mg/dL,"
    "Skanna glukosvärde mg/dL,Icke-numeriskt snabbverkande insulin,Snabbverkande insulin (enheter),Icke-numerisk mat,"
    "Kolhydrater (gram),Kolhydrater (portioner),Icke-numeriskt långtidsverkande insulin,"
    "Långtidsverkande insulin (enheter)",
    "unknown": "A,B,C,D,E mg/dL,F mg/dL,G,H,I,J,K,L,M",
}


@pytest.mark.parametrize("language", LIBRE_HEADERS)
def test_libreview(read, language):
    header = f"{LIBRE_HEADERS[language]},Notes"
    rows = [f"Libre 2,X,{time:%d-%m-%Y %H:%M},0,{glucose(n)},,,,,,,,," for n, time in enumerate(every(15, 40))]
    rows += ["Libre 2,X,13-03-2024 00:10,4,,,,5,,,,,12,", "Libre 2,X,13-03-2024 00:11,5,,,,,,40,,,,"]
    record = read("\n".join(["A,B", header, *rows]) + "\n")
    assert reading_times(record) == every(15, 40)
    sums = [record.frame[name].sum() for name in ("bolus_U", "long_acting_U", "carbs_g")]
    assert sums == [5.0, 12.0, 40.0]
    assert set(record.frame["device"]) == {"FreeStyle Libre 2"}
    assert ("columns were taken by their place" in notes_of(record)) == (language == "unknown")


@pytest.mark.parametrize(
    "header",
    [
        "ID;Hora;Tipo de registro;Histórico glucosa (mg/dL);Glucosa leída (mg/dL);Insulina de acción rápida sin valor "
        "numérico;Insulina de acción rápida (unidades);Alimentos sin valor numérico;Carbohidratos (gramos);Notas",
        "ID;Time;Record Type;Historic Glucose (mg/dL);Scan Glucose (mg/dL);Non-numeric Rapid-Acting Insulin;"
        "Rapid-Acting Insulin (units);Non-numeric Food;Carbohydrates (grams);Notes",
    ],
)
def test_the_program_before_libreview(read, header):
    rows = [f"{n};{time:%Y/%m/%d %H:%M};0;{glucose(n)};;;;;;" for n, time in enumerate(every(15, 40))]
    rows += ["900;2024/03/13 00:10;4;;;;5;;;", "901;2024/03/13 00:11;5;;;;;;40;"]
    record = read("\n".join(["X", header, *rows]) + "\n")
    assert reading_times(record) == every(15, 40)
    assert (record.frame["bolus_U"].sum(), record.frame["carbs_g"].sum()) == (5.0, 40.0)


CLARITY_HEADERS = {
    "Spanish": (
        "Índice,Marca temporal (AAAA-MM-DDThh:mm:ss),Tipo de evento,Subtipo de evento,Paciente,Dispositivo,Origen,"
        "Nivel de glucosa (mg/dL),Insulina,HC,D,T,L,ID",
        "Bajo",
    ),
    "Italian": (
        "Indice,Data e ora (AAAA-MM-GGThh:mm:ss),Tipo di evento,Sottotipo di evento,Paziente,Dispositivo,Origine,"
        "Valore del glucosio (mg/dL),Insulina,Carboidrati,D,T,L,ID trasmettitore",
        "Basso",
    ),
    "Czech": (
        '"Obsah","Časové razítko (RRRR-MM-DDThh:mm:ss)","Typ události","Podtyp události","Údaje pacienta",'
        '"Informace o zařízení","ID zdrojového zařízení","Hodnota glukózy (mg/dL)","Hodnota inzulinu (j)",'
        '"Hodnota sacharidů (gramů)","Trvání (hh:mm:ss)","Rychlost změny glukózy (mg/dL/min)","Čas vysílače",'
        '"ID vysílače"',
        "Nízká",
    ),
}


def test_clarity_that_a_spreadsheet_wrote_again(read):
    rows = [
        re.sub(r"(\d{4})-(\d\d)-(\d\d)T(\d\d:\d\d):\d\d", r"\3/\2/\1 \4", line) for line in clarity(40).splitlines()[1:]
    ]
    text = "\n".join([CLARITY_HEADERS["Italian"][0], *rows]).replace(",", ";")
    assert reading_times(read(text)) == every(5, 40)


@pytest.mark.parametrize("language", CLARITY_HEADERS)
def test_clarity(read, language):
    header, low = CLARITY_HEADERS[language]
    rows = [line.replace("EGV", "NGS") for line in clarity(40).splitlines()[1:]]
    rows += [
        "90,2024-03-13T01:00:00,Insulina,Acción rápida,,,iPhone G6,,4,,,,,",
        "91,2024-03-13T01:01:00,HC,,,,iPhone G6,,,30,,,,",
        f"92,2024-03-13T06:00:00,NGS,{low},,,iPhone G6,{low},,,,,,",
    ]
    record = read("\n".join([header, *rows]) + "\n")
    assert reading_times(record)[:40] == every(5, 40)
    assert record.frame["out_of_range"].drop_nulls().to_list() == ["low"]
    assert (record.frame["bolus_U"].sum(), record.frame["carbs_g"].sum()) == (4.0, 30.0)


def test_carelink(read):
    rows = [
        (START, {"Basal Rate": "1,0"}),
        (START.replace(hour=1), {"Bolus Volume Selected": "3,0", "Bolus Volume Delivered": "2,9"}),
        (START.replace(hour=2), {"Suspend": "Interrumpido por el usuario"}),
        (START.replace(hour=3), {"Suspend": "Reanudación"}),
        (START.replace(hour=4), {"BWZ Carb Input": "35"}),
        (START.replace(hour=5), {"Event Marker": "Comida: 60,00gramos"}),
    ]
    sensor = [(time, {"Sensor Glucose": str(glucose(number))}) for number, time in enumerate(every(5, 40))]
    english = carelink(rows, sensor)
    names = CARELINK_HEADER.split(";")
    spanish = ";".join(
        name if "(" not in name else f"Columna {n} ({name.partition('(')[2]}" for n, name in enumerate(names)
    )
    spanish = spanish.replace("Index;Date;Time;", "Índice;Fecha;Hora;").replace(";Suspend;", ";Suspensión;")
    record = read(english.replace(CARELINK_HEADER, spanish))
    expected = read(english).frame
    assert record.frame.equals(expected)
    assert expected["basal_U_h"].drop_nulls().to_list() == [1.0, 0.0, 1.0]
    assert record.left_out == {"event markers in a language that is not known": 1}
