"""A controller in C with the patient of a short scenario, shared by the tests of hardware in the loop."""

import dataclasses
import functools
import warnings

import pytest

from glucoloop.build.designs import controller_of
from glucoloop.build.surroundings import surroundings_of
from glucoloop.component.effects import NoEffectWarning
from glucoloop.firmware.exported import export
from glucoloop.firmware.hil.build import HOST, build
from glucoloop.firmware.hil.link import ProcessLink
from glucoloop.firmware.hil.loop import run_on_chip
from glucoloop.firmware.hil.protocol import Payloads, plan_at
from glucoloop.firmware.samples import example
from glucoloop.meals import Meal, Scenario
from glucoloop.sensors import WhiteNoise
from glucoloop.simulation import simulate
from glucoloop.simulation.stepper import scenario_stepper
from glucoloop.situations.case import default_case
from glucoloop.situations.run import Run
from glucoloop.situations.situation import Situation, configured


@dataclasses.dataclass
class OnChip:
    """A controller in C, and its patient."""

    exported: object
    controller: object
    stepper: object
    scenario: object

    def link(self, folder, chip=HOST, *warnings):
        folder.mkdir(exist_ok=True)
        command = build(self.exported, chip, folder, warnings)
        return ProcessLink(command, folder, plan_at(self.exported.source, self.payloads))

    @property
    def payloads(self):
        return Payloads(self.exported.source, self.exported.precision)

    def run(self, link, **options):
        self.stepper.reset()
        try:
            return run_on_chip(self.exported, self.stepper, self.scenario, link, **options)
        finally:
            link.close()

    def simulated(self):
        """The same loop without a chip and without C."""
        self.stepper.reset()
        loop = self.stepper._fixed.joined(self.stepper._numbers)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NoEffectWarning)  # not every controller goes by the time of day
            return simulate(self.stepper.patient, self.controller, loop.sensor, loop.pump, self.scenario, key=3)

    def lasting(self, minutes):
        return dataclasses.replace(self, scenario=Scenario(self.scenario.meals, minutes))


def together(situation, case, scenario, precision="float32"):
    """The controller of a case in C, and the patient of a scenario."""
    controller, around = controller_of(situation, case), surroundings_of(situation)
    stepper = scenario_stepper(
        situation.nominal, around.sensor, around.pump, scenario, sample_time_min=situation.sample_time_min, key=3
    )
    exported = export(controller, situation.limits, example(controller, stepper), [case.label], precision=precision)
    return OnChip(exported, controller, stepper, scenario)


@pytest.fixture(scope="session")
def on_chip():
    """A PID; the meal comes within a sample, and readings are noisy."""
    situation = Situation(sensor=(WhiteNoise(variance=1.45),))
    return together(situation, default_case("pid", situation), Scenario((Meal(50.0, 17.0, 10.0),), 120.0))


@pytest.fixture(scope="session")
def told_of_a_meal():
    """Function of a controller's name: that controller, guarded, for insulin under the skin.

    It is told of the meal 15 min before, in the sample of 27 min, and of the time of day.
    """

    @functools.cache
    def of(name):
        told = {"announce_meals": True, "announce_before_min": 15.0, "start": "11:00"}
        day = {"meals": ["50g@42min/10min"], "duration_min": 120.0}
        run = configured(Run, patient="hovorka-2004", controller=[name], guard="usual", **told, **day)
        return together(run, run.case, run.as_scenario(), "float64")

    return of
