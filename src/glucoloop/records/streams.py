"""Readings, doses and meals that several apps log of one person, each of which counts once.

A stream is what one device or app sends. Two streams are of one sensor where they say the same glucose, shifted by up
to some minutes, whatever the names of the devices are; sensors that disagree are told apart. While one stream reads,
the readings of another are left out by name; where the first has a gap the other one fills it.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import polars as pl

from glucoloop.records.extract import Account, parts_of
from glucoloop.refusal import Refusal
from glucoloop.text import how_many, printable, the_first
from glucoloop.units import MIN_PER_H, S_PER_MIN

Floats = npt.NDArray[np.float64]

SAME_GLUCOSE: Final = "readings of the same sensor by another uploader"
OTHER_GLUCOSE: Final = "readings of a second sensor while the first one reads"
TWICE: Final = "readings that stand there twice, at slightly different times"
OTHER_DEVICE: Final = "readings of other devices than the one that is chosen"

_SHIFTS_MIN: Final = np.arange(-15.0, 16.0)
_MAX_MEDIAN, _MAX_90 = (4.0, 0.03), (15.0, 0.10)
"""Largest median and 90th percentile of the difference of two streams of one sensor, in mg/dl and of glucose."""
_SAMPLES: Final = 2000
_FEWEST: Final = 12
"""Number of readings from which two streams can be compared."""
_LONGEST_STEP_MIN: Final = 30.0
_BESIDE: Final = 0.9
"""Part of a step from another stream's reading within which one at the edge of a gap is beside it."""
_COPIED: Final = 0.9
_ROUNDED_MG_DL: Final = 1.0
"""Share of readings that are the same, but for rounding, in two uploads of them."""
_MAX_WAYS: Final = 3
"""Largest number of streams that are told apart under one name."""
_ALMOST_ALL: Final = 0.98
"""Share of lags with which a step is as good as one of a larger share."""
_REGULAR: Final = 0.8
"""Share of steps that are alike in a regular stream."""
_JITTER_MIN: Final = 0.25


class _Stream(NamedTuple):
    """Readings of one stream in the order of time."""

    label: str
    source: str
    places: npt.NDArray[np.int64]
    t_min: Floats
    glucose: Floats
    step_min: float


def with_instants(frame: pl.DataFrame) -> pl.DataFrame:
    """Rows with ``at``: instants in UTC, or where offsets are unknown the time on the wall without a step back.

    What comes after a repeated hour is an hour later too, so that it lies behind the second pass.
    """
    if frame["utc_offset_min"].is_null().any():
        ends = frame.filter("second_pass")["time"].dt.truncate("1h").dt.offset_by("1h").unique().sort()
        hours = pl.col("second_pass").cast(pl.Int64)
        for end in ends:
            hours += (pl.col("time") >= end).cast(pl.Int64)
        at = pl.col("time") + pl.duration(hours=hours, time_unit="us")
    else:
        at = pl.col("time") - pl.duration(minutes="utc_offset_min", time_unit="us")
    return frame.with_columns(at=at)


def one_sensor(frame: pl.DataFrame, device: str | None, account: Account) -> pl.DataFrame:
    """Rows in which each time has the readings of one sensor once; `device` is the one that is chosen."""
    read = frame.select(
        place=pl.int_range(pl.len(), dtype=pl.Int64),
        reading=pl.col("glucose_mg_dl").is_not_null(),
        t=pl.col("at").to_physical() / (1e6 * S_PER_MIN),
        glucose="glucose_mg_dl",
        device="device",
        source=source_of(),
        named=pl.col("source").is_not_null(),
    ).filter("reading")
    if not read.height:
        if device is not None:
            raise Refusal(f"device is {device!r}, and there are no readings", "leave it out (--device)")
        return frame
    groups = [group.sort("t") for group in parts_of(read, "source")]
    for group in groups:
        if group["named"].all():
            continue
        twice = _second_trajectory(group, account)
        if twice.size:
            gone = np.zeros(frame.height, dtype=bool)
            gone[twice] = True
            source = group["source"][0]
            frame = frame.with_columns(_twice=pl.Series(gone))
            frame = _each_dose_of_two_uploads_once(frame, source, account)
            frame = account.without_value(frame, frame["_twice"], "glucose_mg_dl", TWICE).drop("_twice")
            return one_sensor(frame, device, account)
    streams = _labelled([part for group in groups for part in (_parted(group) if group["named"].all() else [group])])
    if len(streams) > 1:
        labels = np.full(frame.height, None, dtype=object)
        for stream in streams:
            labels[stream.places] = stream.label
        frame = frame.with_columns(device=pl.coalesce(pl.Series(labels.tolist(), dtype=pl.String), "device"))
    if device is not None:
        return _only(frame, streams, device, account)
    if len(streams) == 1:
        return frame
    streams.sort(key=lambda stream: stream.t_min.size, reverse=True)
    reasons = np.full(frame.height, "", dtype=object)
    used = [streams[0]]
    for stream in streams[1:]:
        for first in used:
            doubled = _doubled(stream, first) & (reasons[stream.places] == "")
            if doubled.any():
                reasons[stream.places[doubled]] = _compared(stream, first, doubled, account)
        used.append(_without(stream, reasons[stream.places] != ""))
    counts = [f"{stream.label} ({stream.t_min.size})" for stream in streams]
    kinds = {stream.label for stream in streams}
    if len(kinds) > 1:
        account.notes.append(f"Glucose comes from {len(kinds)} devices: {the_first(counts)}.")
    frame = frame.with_columns(pl.Series("_why", reasons.tolist(), dtype=pl.String))
    for reason in (SAME_GLUCOSE, OTHER_GLUCOSE):
        frame = account.without_value(frame, frame["_why"] == reason, "glucose_mg_dl", reason)
    return frame.drop("_why")


def _parted(rows: pl.DataFrame) -> list[pl.DataFrame]:
    """Streams that one source sends under one name, each at regular steps; the source itself where it is one."""
    t = rows["t"].to_numpy()
    step = _step_of_several(t)
    if step is None:
        return [rows]
    chains: list[float] = []
    which = np.zeros(t.size, dtype=np.int64)
    for place, moment in enumerate(t.tolist()):
        late = [abs(moment - last - step * max(1, round((moment - last) / step))) for last in chains]
        free = [n for n, last in enumerate(chains) if moment - last > _REGULAR * step]
        near = min(free, key=lambda n: late[n]) if free else -1
        if near >= 0 and (late[near] <= (1.0 - _REGULAR) * step or len(chains) == _MAX_WAYS):
            which[place] = near
        elif len(chains) < _MAX_WAYS:
            which[place] = len(chains)
            chains.append(moment)
        else:
            which[place] = int(np.argmin(late))
        chains[which[place]] = moment
    parts = rows.with_columns(pl.Series("_way", which)).partition_by("_way")
    regular = all(_regular(np.diff(part["t"].to_numpy())) is not None for part in parts if part.height > _FEWEST)
    return parts if regular else [rows]


def _step_of_several(t: Floats) -> float | None:
    """Step of streams that stand interleaved in one; None where it is one stream, or not made of regular ones."""
    if t.size < 3 * _FEWEST:
        return None
    steps = np.rint(np.diff(t))
    usual = float(np.median(steps))
    alike, short = steps == usual, steps < _REGULAR * usual
    if usual > 0.0 and np.count_nonzero(alike) > _ALMOST_ALL * t.size and np.count_nonzero(short) < _FEWEST:
        return None  # no other step is that of more of them, so this one would be the best of the search below
    lags = [steps, *(np.rint(t[ways:] - t[:-ways]) for ways in range(2, _MAX_WAYS + 1))]
    best, covered = 0.0, -1
    for step in np.unique(np.concatenate([lag[lag <= _LONGEST_STEP_MIN] for lag in lags])):
        if step > 1.0:
            there = np.zeros(t.size, dtype=bool)
            for lag in lags:
                there[: lag.size] |= np.abs(lag - step) <= 0.1 * step
            if np.count_nonzero(there) > covered + (1.0 - _ALMOST_ALL) * t.size:
                best, covered = float(step), int(np.count_nonzero(there))
    short, even = lags[0] < _REGULAR * best, _even(np.diff(t))
    extra, faster = (int(np.count_nonzero(short & part)) for part in (~even, even))
    several = extra >= max(_FEWEST, faster)  # a stream that reads more often for a while is one
    return best if covered >= _REGULAR * t.size and several else None


def _even(steps: Floats) -> npt.NDArray[np.bool_]:
    """Steps that are like the one before and the one after, as those of one stream are and interleaved ones are not."""
    alike = np.abs(np.diff(steps)) <= (1.0 - _REGULAR) * np.maximum(steps[1:], steps[:-1]) + _JITTER_MIN
    return np.asarray(np.append(alike, False) & np.insert(alike, 0, False))


def _regular(steps: Floats) -> float | None:
    """Step of a stream of which most steps are alike; None if they are not."""
    inside = steps[(steps > 0.0) & (steps <= _LONGEST_STEP_MIN)]
    if inside.size < _REGULAR * steps.size or not inside.size:
        return None
    step = float(np.median(inside))
    alike = np.abs(inside / step - np.maximum(1.0, np.rint(inside / step))) <= (1.0 - _REGULAR) + 0.05
    return step if np.count_nonzero(alike) >= _REGULAR * inside.size else None


def _labelled(parts: list[pl.DataFrame]) -> list[_Stream]:
    """Streams, each with the kind of its device, numbered where several of a kind read at the same time."""
    parts.sort(key=lambda part: part["t"][0])
    ends: dict[str, list[float]] = {}
    result = []
    for part in parts:
        t = part["t"].to_numpy()
        kind = part["device"].drop_nulls().mode().sort()
        name = str(kind[0]) if len(kind) else "a sensor"
        slots = ends.setdefault(name, [])
        slot = next((n for n, end in enumerate(slots) if end < t[0]), len(slots))
        slots[slot : slot + 1] = [t[-1]]
        steps = np.diff(t)
        inside = steps[(steps > 0.0) & (steps <= _LONGEST_STEP_MIN)]
        step = float(np.median(inside)) if inside.size else _LONGEST_STEP_MIN
        label = name if not slot else f"{name} ({slot + 1})"
        result.append(_Stream(label, part["source"][0], part["place"].to_numpy(), t, part["glucose"].to_numpy(), step))
    return result


def _only(frame: pl.DataFrame, streams: list[_Stream], device: str, account: Account) -> pl.DataFrame:
    """Rows without the readings of other devices than the one that is chosen; Refusal if there is none of its name."""
    chosen = [stream for stream in streams if stream.label.casefold() == device.casefold()]
    if not chosen:
        names = list(dict.fromkeys(printable(stream.label) for stream in streams))
        raise Refusal(
            f"device is {device!r}, and the readings are of {the_first(names)}", "give one of these (--device)"
        )
    keep = np.concatenate([stream.places for stream in chosen])
    other = np.ones(frame.height, dtype=bool)
    other[keep] = False
    gone = pl.Series(other) & frame["glucose_mg_dl"].is_not_null()
    return account.without_value(frame, gone, "glucose_mg_dl", OTHER_DEVICE)


def _without(stream: _Stream, gone: npt.NDArray[np.bool_]) -> _Stream:
    kept = ~gone
    return stream._replace(places=stream.places[kept], t_min=stream.t_min[kept], glucose=stream.glucose[kept])


def _doubled(stream: _Stream, first: _Stream) -> npt.NDArray[np.bool_]:
    """Readings of a stream at times when another one reads."""
    if not first.t_min.size or not stream.t_min.size:
        return np.zeros(stream.t_min.size, dtype=bool)
    reach = first.step_min + 0.5
    after = np.searchsorted(first.t_min, stream.t_min)
    before_min = stream.t_min - first.t_min[(after - 1).clip(0)]
    after_min = first.t_min[after.clip(0, first.t_min.size - 1)] - stream.t_min
    before_min = np.where(after > 0, before_min, np.inf)
    after_min = np.where(after < first.t_min.size, after_min, np.inf)
    between = (before_min < reach) & (after_min < reach)
    inside = between | (np.minimum(before_min, after_min) < _BESIDE * first.step_min)
    return np.asarray(inside)


class _Comparison(NamedTuple):
    """Comparison of the readings of a stream with those of another one at the same times."""

    same: bool
    """Whether they are of one sensor."""
    shift_min: float
    """Time by which they are later."""
    apart_mg_dl: float
    """Median of their distance without that shift."""


def _comparison(stream: _Stream, first: _Stream, doubled: npt.NDArray[np.bool_]) -> _Comparison:
    t, glucose = stream.t_min[doubled], stream.glucose[doubled]
    chosen = np.linspace(0, t.size - 1, min(t.size, _SAMPLES)).astype(int)
    t, glucose = t[chosen], glucose[chosen]
    shifts = _SHIFTS_MIN if t.size >= _FEWEST else np.zeros(1)
    differences = [np.abs(np.interp(t - shift, first.t_min, first.glucose) - glucose) for shift in shifts]
    best = int(
        np.argmin([float(np.median(of)) + 0.1 * abs(shift) for of, shift in zip(differences, shifts, strict=True)])
    )
    middle = float(np.median(glucose))
    median, upper = (float(np.quantile(differences[best], share)) for share in (0.5, 0.9))
    apart = float(np.median(differences[int(np.flatnonzero(shifts == 0.0)[0])]))
    same = median <= max(_MAX_MEDIAN[0], _MAX_MEDIAN[1] * middle) and upper <= max(_MAX_90[0], _MAX_90[1] * middle)
    return _Comparison(same, float(shifts[best]), apart)


def _hours(stream: _Stream, doubled: npt.NDArray[np.bool_]) -> str:
    return how_many(round(int(np.count_nonzero(doubled)) * stream.step_min / MIN_PER_H), "hour")


def _second_trajectory(rows: pl.DataFrame, account: Account) -> npt.NDArray[np.int64]:
    """Places of readings that name no source and stand there twice, at slightly different times.

    Two trajectories that disagree, as those of two sensors, are noted, and all of them stay: nothing says that a table
    holds more than it was made to hold.
    """
    parts = _parted(rows)
    nothing = np.zeros(0, dtype=np.int64)
    if len(parts) == 1:
        return nothing
    first, *others = sorted(_labelled(parts), key=lambda stream: stream.t_min.size, reverse=True)
    for stream in others:
        doubled = _doubled(stream, first)
        if np.count_nonzero(doubled) < _FEWEST:
            continue
        compared = _comparison(stream, first, doubled)
        if not compared.same:
            account.notes.append(
                f"Readings follow two trajectories at the same time for {_hours(stream, doubled)}, "
                f"{compared.apart_mg_dl:.0f} mg/dl apart in the median, as those of two sensors do. All are kept, for "
                "nothing names their sensors; divide the table by its sensors to choose one."
            )
            return nothing
        copied = _copied(stream, first, doubled)
        if np.count_nonzero(copied) < max(_FEWEST, _COPIED * np.count_nonzero(doubled)):
            continue
        account.notes.append(
            f"Readings stand there twice for {_hours(stream, copied)}, at slightly different times, as after two "
            "uploads; they count once."
        )
        return stream.places[copied]
    return nothing


def _copied(stream: _Stream, first: _Stream, doubled: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Mask of the doubled readings of a stream that are those of another one at nearly the same time."""
    after = np.searchsorted(first.t_min, stream.t_min).clip(1, first.t_min.size - 1)
    earlier = stream.t_min - first.t_min[after - 1] <= first.t_min[after] - stream.t_min
    nearest = first.glucose[np.where(earlier, after - 1, after)]
    return np.asarray(doubled & (np.abs(nearest - stream.glucose) <= _ROUNDED_MG_DL))


def _each_dose_of_two_uploads_once(frame: pl.DataFrame, source: str, account: Account) -> pl.DataFrame:
    """Rows in which an amount within two minutes counts once while readings are there twice."""
    read = frame.filter("_twice")["at"]
    for name, words in _AMOUNTS.items():
        inside = frame["at"].is_between(read.min(), read.max())
        if frame.filter(inside & frame[name].is_not_null()).height > 1:
            reason = words.replace("that another app has", "that stand there twice")
            frame = account.without_value(frame, _repeated(frame, name, once=source) & inside, name, reason)
    return frame


def _compared(stream: _Stream, first: _Stream, doubled: npt.NDArray[np.bool_], account: Account) -> str:
    """Reason for which readings of a stream are left out, and a note on how it compares with the one that is used."""
    hours = _hours(stream, doubled)
    same, shift_min, apart = _comparison(stream, first, doubled)
    if same:
        shift = f", {abs(shift_min):g} min {'later' if shift_min > 0 else 'earlier'}" if shift_min else ""
        account.notes.append(
            f"{stream.label} and {first.label} say the same glucose{shift}, for {hours}; {first.label} is used there."
            if stream.label != first.label
            else f"Two uploaders of {first.label} say the same glucose{shift}, for {hours}; it counts once."
        )
        return SAME_GLUCOSE
    if stream.source == first.source:
        account.notes.append(
            f"Readings of one source follow two trajectories at the same time for {hours}, {apart:.0f} mg/dl apart in "
            f"the median, as those of two sensors do. Both are kept, as {first.label} and {stream.label}; device "
            "(--device) chooses one."
        )
        return ""
    account.notes.append(
        f"{stream.label} and {first.label} read at the same time for {hours} and disagree, by {apart:.0f} mg/dl in "
        f"the median; {first.label}, which has more readings, is used there, and device (--device) chooses another one."
    )
    return OTHER_GLUCOSE


TOGETHER_S: Final = 120.0
"""Longest time between the same amount in two apps."""

_AMOUNTS: Final = {
    "bolus_U": "boluses that another app has within 2 min",
    "long_acting_U": "doses of long-acting insulin that another app has within 2 min",
    "carbs_g": "carbohydrate that another app has within 2 min",
    "glucagon_ug": "doses of glucagon that another app has within 2 min",
}


def source_of() -> pl.Expr:
    """Device or app of each row; the file itself where that does not tell it."""
    return pl.coalesce("source", pl.format("file {}", "file"))


def each_dose_once(frame: pl.DataFrame, account: Account) -> pl.DataFrame:
    """Rows in which an amount that a second app, or a second kind of entry, has too is left out.

    The same amount within two minutes from another source is the same dose; the same source may give it twice.
    """
    for name, words in _AMOUNTS.items():
        if frame.filter(pl.col(name).is_not_null()).height > 1:
            frame = account.without_value(frame, _repeated(frame, name), name, words)
    return frame


def _repeated(frame: pl.DataFrame, name: str, once: str | None = None) -> pl.Series:
    """Whether the amount of each row is that of an earlier row from another source, or from one that counts once."""
    own = frame.with_row_index("_place").filter(pl.col(name).is_not_null()).sort(name, "at", maintain_order=True)
    own = own.with_columns(source=source_of())
    amounts, sources = own[name].to_list(), own["source"].to_list()
    seconds = (own["at"].to_physical() / 1e6).to_list()
    counted: list[tuple[int, set[str]]] = []
    places: list[int] = []
    for row in range(own.height):
        same = [
            known
            for first, known in counted[-4:]
            if amounts[first] == amounts[row]
            and seconds[row] - seconds[first] <= TOGETHER_S
            and (sources[row] == once or (once is None and sources[row] not in known))
        ]
        if same:
            same[-1].add(sources[row])
            places.append(own["_place"][row])
        else:
            counted.append((row, {sources[row]}))
    second = pl.Series(places, dtype=pl.UInt32)
    return frame.select(pl.int_range(pl.len(), dtype=pl.UInt32).is_in(second.implode())).to_series()
