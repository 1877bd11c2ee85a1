"""What the page says that a controller expects is what the controller decided by."""

import numpy as np
import pytest

SAMPLES = [0, 12, 15, 20, 30, 60]


@pytest.mark.parametrize("guard", ["", "&guard=usual"])
@pytest.mark.parametrize(
    "controller",
    [
        "mpc,+move_weight=4&sensor=dead-time,+minutes=10",
        "mpc-se&sensor=white-noise,+variance=1.45",
        "mpc&patient=hovorka-2004",
        "mpc-se&patient=wilinska-2010&sensor=white-noise,+variance=1.45",
    ],
)
def test_the_expected_glucose_gives_the_dose(in_node, data, controller, guard):
    [answer] = in_node([{"link": f"#controller={controller}{guard}&meals=20g%4050min", "samples": SAMPLES}])
    trace, inner = answer["trace"], "inner." if guard else ""
    numbers = {name: np.asarray(value, float) for name, value in answer["numbers"].items() if value is not None}
    gain = numbers[f"controller.{inner}plan.gain"]
    setpoint = data["patients"][answer["situation"]["patient"]]["setpoint_mg_dl"]
    checked = 0
    for sample, expected in zip(SAMPLES, answer["predictions"], strict=True):
        free = np.asarray(expected["free_mg_dl"])[1:]
        assert free.size == gain.size
        assert expected["t_min"] == [5.0 * (sample + i) for i in range(gain.size + 1)]
        reference = np.full(gain.size, setpoint)
        if controller.startswith("mpc-se"):
            reference += numbers[f"controller.{inner}reference"] * (expected["now_mg_dl"] - setpoint)
        wanted = expected["rate_mU_min"] + gain @ (reference - free)
        if trace["status"][sample] == 0:  # the controller's own dose, which nothing limited
            assert wanted == pytest.approx(trace["command_mU_min"][sample], abs=1e-9)
            checked += 1
    assert checked >= 3


@pytest.mark.parametrize("guard", ["", "&guard=usual"])
@pytest.mark.parametrize(
    "controller", ["pid&sensor=white-noise,+variance=1.45", "imc,+filter_min=20", "imc&patient=hovorka-2004"]
)
def test_the_terms_add_up_to_the_dose(in_node, controller, guard):
    [answer] = in_node([{"link": f"#controller={controller}{guard}&meals=20g%4050min", "samples": SAMPLES}])
    trace, checked = answer["trace"], 0
    for sample, terms in zip(SAMPLES, answer["terms"], strict=True):
        if trace["status"][sample] != 0:  # limited, or without a reading
            continue
        if "pid" in terms:
            wanted = sum(terms["pid"].values())
        else:
            wanted = terms["imc"]["wanted_mU_min"]
            setpoint = trace["glucose_mg_dl"][0]
            distance = terms["imc"]["model_mg_dl"] + terms["imc"]["rest_mg_dl"]
            assert distance == pytest.approx(trace["reading_mg_dl"][sample] - setpoint, abs=1e-6)
        assert wanted == pytest.approx(trace["command_mU_min"][sample], abs=1e-9)
        checked += 1
    assert checked >= 3
