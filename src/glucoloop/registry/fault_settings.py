"""Settings of the faults, each declared once: type, bounds, unit, meaning and default.

Nothing here imports JAX, so that help is shown at once.
"""

from __future__ import annotations

from typing import Annotated

from glucoloop.plausible import GLUCOSE_BOUND, RATE_STEP
from glucoloop.refusal import Refusal
from glucoloop.registry.settings import About, settings_record

Noticed = Annotated[bool, About("Whether the pump reports the fault: true or false.")]


@settings_record
class FaultTimes:
    """Times of a fault, which have no value unless one is given."""

    start_min: Annotated[float, About("Time at which the fault begins, rounded up to a sample.")] = 0.0
    latest_min: Annotated[
        float, About("Latest start; the start is drawn between start_min and it, for each person.")
    ] = 0.0
    duration_min: Annotated[
        float, About("Duration of the fault; by default to the end, or one sample with per_day.")
    ] = 0.0
    per_day: Annotated[float, About("Mean number of random occurrences in a day, in place of a start.")] = 0.0


@settings_record
class FaultKey:
    """Random draws of a fault."""

    key: Annotated[int, About("Number that makes the random draws of two faults of the same kind differ.")] = 0


@settings_record
class LateSettings:
    """Settings of the fault `late`."""

    delay_min: Annotated[float, About("Delay of the readings, rounded up to samples.", above=0.0)] = 15.0


@settings_record
class RepeatedSettings:
    """Settings of the fault `repeated`."""

    times: Annotated[
        int, About("Number of times that each reading is given.", at_least=2, called="number of repetitions")
    ] = 3


@settings_record
class OutOfOrderSettings:
    """Settings of the fault `out-of-order`."""

    among: Annotated[
        int,
        About("Number of latest readings among which one is drawn.", at_least=2, at_most=48, called="choice among"),
    ] = 4


@settings_record
class SpikesSettings:
    """Settings of the fault `spikes`."""

    size_mg_dl: Annotated[float, About("Error of the readings, of either sign.", called="spike")] = 60.0


@settings_record
class DriftSettings:
    """Settings of the fault `drift`."""

    mg_dl_h: Annotated[float, About("Growth of the error in an hour, of either sign.", called="drift")] = 5.0


@settings_record
class CalibrationSettings:
    """Settings of the fault `calibration`."""

    gain: Annotated[
        float, About("Factor from the correct reading to the given one.", above=0.0, called="calibration gain")
    ] = 1.15
    offset_mg_dl: Annotated[float, About("Offset that is added after the gain.", called="calibration offset")] = 0.0


@settings_record
class CompressionSettings:
    """Settings of the fault `compression`."""

    depth: Annotated[
        float,
        About("Part of the reading that is finally lost.", above=0.0, at_most=1.0, called="compression depth"),
    ] = 0.3
    tau_min: Annotated[float, About("Time constant of fall and recovery.", above=0.0, called="time constant")] = 10.0


@settings_record
class SaturationSettings:
    """Settings of the fault `saturation`."""

    low_mg_dl: Annotated[
        float, About("Lower end of the range.", at_least=0.0, quantity=GLUCOSE_BOUND, called="lower end")
    ] = 40.0
    high_mg_dl: Annotated[
        float, About("Upper end of the range.", above=0.0, quantity=GLUCOSE_BOUND, called="upper end")
    ] = 400.0

    def __post_init__(self) -> None:
        if not self.low_mg_dl < self.high_mg_dl:
            raise Refusal(
                f"a sensor range of {self.low_mg_dl:g} to {self.high_mg_dl:g} mg/dl is not possible; "
                "give an upper end above the lower one"
            )


@settings_record
class NonsenseSettings:
    """Settings of the fault `nonsense`."""

    value: Annotated[float, About("Number that is given.", finite=False)] = 0.0


@settings_record
class ResolutionSettings:
    """Settings of the fault `resolution`."""

    step_mU_min: Annotated[
        float, About("Step of the rate.", above=0.0, quantity=RATE_STEP, called="delivery resolution")
    ] = 0.5
    least_mU_min: Annotated[float, About("Least rate that is delivered.", at_least=0.0, called="least dose")] = 0.0


@settings_record
class MissedPulsesSettings:
    """Settings of the fault `missed-pulses`."""

    share: Annotated[
        float, About("Share of the doses that are missed.", at_least=0.0, at_most=1.0, called="share of missed doses")
    ] = 0.2
    noticed: Noticed = False


@settings_record
class OcclusionSettings:
    """Settings of the fault `occlusion`."""

    open_fraction: Annotated[float, About("Part of the insulin that is delivered.", at_least=0.0, below=1.0)] = 0.0
    noticed: Noticed = False
