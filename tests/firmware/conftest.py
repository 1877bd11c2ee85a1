"""A controller in C with the patient of a short scenario, shared by the tests of hardware in the loop."""

import dataclasses

import pytest

from glucoloop.experiments.designs import controller_of
from glucoloop.experiments.surroundings import surroundings_of
from glucoloop.firmware.exported import export
from glucoloop.firmware.hil.build import HOST, build
from glucoloop.firmware.hil.link import ProcessLink
from glucoloop.firmware.hil.loop import run_on_chip
from glucoloop.firmware.hil.protocol import Payloads, plan_at
from glucoloop.firmware.samples import example
from glucoloop.meals import Meal, Scenario
from glucoloop.sensors.settings import WhiteNoiseSettings
from glucoloop.simulation.stepper import scenario_stepper
from glucoloop.situations.case import usual_case
from glucoloop.situations.situation import Situation


@dataclasses.dataclass
class OnChip:
    """A guarded PID in C, and its patient; the meal comes within a sample, and readings are noisy."""

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

    def lasting(self, minutes):
        return dataclasses.replace(self, scenario=Scenario(self.scenario.meals, minutes))


@pytest.fixture(scope="session")
def on_chip():
    situation = Situation(sensor=(WhiteNoiseSettings(variance=1.45),))
    case = usual_case("pid", situation)
    controller = controller_of(situation, case)
    scenario = Scenario((Meal(50.0, 17.0, 10.0),), 120.0)
    around = surroundings_of(situation)
    stepper = scenario_stepper(
        situation.nominal, around.sensor, around.pump, scenario, sample_time_min=situation.sample_time_min, key=3
    )
    exported = export(controller, situation.limits, example(controller, stepper), ["pid"])
    return OnChip(exported, controller, stepper, scenario)
