"""Hardware in the loop: whatever happens to link and power, each decision has the bits of an undisturbed one."""

import json
import os
import shutil
import struct
import subprocess
from pathlib import Path

import jax
import numpy as np
import pytest

from glucoloop.cli.app import main
from glucoloop.control.catalogue import CONTROLLERS
from glucoloop.control.protocol import Status
from glucoloop.firmware.chips import CHIPS
from glucoloop.firmware.hil.build import HOST
from glucoloop.firmware.hil.exchange import Exchange, _Patience
from glucoloop.firmware.hil.faults import Disturbances
from glucoloop.firmware.hil.link import SerialLink
from glucoloop.firmware.hil.loop import Pace, _Fallback
from glucoloop.firmware.hil.protocol import WATCHDOG_MS, Decoder, Frame, Plan, Type, record_bytes
from glucoloop.firmware.samples import leaves_of
from glucoloop.native.targets.c.host import compiler
from glucoloop.simulation.stepper import simulate_stepped

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler: install gcc")


def equal(one, other):
    return all(
        np.array_equal(a, b, equal_nan=True) for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    )


@pytest.fixture(scope="module")
def undisturbed(on_chip, tmp_path_factory):
    return on_chip.run(on_chip.link(tmp_path_factory.mktemp("chip"), HOST, "-Werror"))


@pytest.mark.long
def test_decisions_from_outside_give_the_trace_of_the_simulation(on_chip):
    controller, state = on_chip.controller, None

    def decide(sample, seen):
        nonlocal state
        state = controller.init(seen) if sample == 0 else state
        state, decision = step(state, seen)
        return decision

    step = jax.jit(controller.step)
    there = on_chip.simulated()
    here = simulate_stepped(on_chip.stepper, on_chip.scenario, decide)
    for one, other in zip(jax.tree.leaves(here), jax.tree.leaves(there), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13)  # two compiled programs round in their own ways


@pytest.mark.long
def test_the_chip_gives_the_bits_of_the_controller_without_a_chip(undisturbed):
    assert all(undisturbed.answered)
    assert undisturbed.equal == [True] * 24
    assert list(undisturbed.sessions) == [0]
    assert np.ptp(np.asarray(undisturbed.trace.command_mU_min)) > 5.0
    assert Status.NO_ANSWER not in np.asarray(undisturbed.trace.status)


@pytest.mark.long
def test_disturbances_change_no_bit_of_the_run(on_chip, undisturbed, tmp_path):
    disturbances = Disturbances(power_cuts=40, hangs=1, damaged=15, lost=6, doubled=8, late=8)
    run = on_chip.run(on_chip.link(tmp_path), disturbances=disturbances, seed=5)
    assert sum(number for kind, number in run.counts.items() if "frames" not in kind) == 78
    assert run.counts["contradictions"] == 0
    assert all(run.answered)
    assert run.equal == [True] * 24
    assert equal(run.trace, undisturbed.trace)


def test_a_sample_without_an_answer_gets_the_fallback_and_no_later_decision_differs(on_chip, undisturbed, tmp_path):
    run = on_chip.run(on_chip.link(tmp_path), disturbances=Disturbances(outages=6, power_cuts=5), seed=2)
    silent = ~np.asarray(run.answered)
    status, command = np.asarray(run.trace.status), np.asarray(run.trace.command_mU_min)
    basal = float(on_chip.stepper.start.insulin_mU_min)
    assert silent.sum() == 6
    assert np.array_equal(status == Status.NO_ANSWER, silent)
    before = np.flatnonzero(silent).min()
    assert np.array_equal(command[:before], np.asarray(undisturbed.trace.command_mU_min)[:before])
    assert np.all(command[silent] <= basal)
    assert run.differing == []
    last_heard = 23 - int(np.argmin(silent[::-1]))
    assert run.equal[: last_heard + 1] == [True] * (last_heard + 1)
    assert not equal(run.trace, undisturbed.trace)


BOLUSES = [name for name, part in CONTROLLERS.items() if part.gives_boluses]
ANNOUNCED = 5
"""Sample in which the meal is announced."""


@pytest.fixture(scope="module")
def bolus(told_of_a_meal, tmp_path_factory):
    """A run with a bolus for the announced meal."""
    told = told_of_a_meal("basal-bolus")
    return told.run(told.link(tmp_path_factory.mktemp("chip"), HOST, "-Werror"))


@pytest.mark.long
@pytest.mark.parametrize("name", BOLUSES)
def test_a_meal_that_is_announced_over_the_link_gets_the_doses_of_the_simulation(told_of_a_meal, name, tmp_path):
    told = told_of_a_meal(name)
    here, there = told.run(told.link(tmp_path)), told.simulated()
    assert here.equal == [True] * 24
    assert here.late_boluses_mU == []
    assert np.max(here.trace.bolus_mU[ANNOUNCED:]) > 500.0
    for dose in ("command_mU_min", "command_bolus_mU"):  # XLA fuses some sums with products
        np.testing.assert_allclose(getattr(here.trace, dose), getattr(there, dose), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(here.trace.status, there.status)


@pytest.mark.long
def test_frames_that_come_twice_and_power_cuts_give_a_bolus_once(told_of_a_meal, bolus, tmp_path):
    told = told_of_a_meal("basal-bolus")
    disturbances = Disturbances(power_cuts=40, hangs=1, damaged=15, lost=6, doubled=24, late=8)
    run = told.run(told.link(tmp_path), disturbances=disturbances, seed=5)
    assert np.flatnonzero(run.trace.bolus_mU).tolist() == [ANNOUNCED]
    assert equal(run.trace, bolus.trace)


@pytest.mark.long
def test_a_bolus_that_is_decided_too_late_is_not_given_and_is_told(told_of_a_meal, bolus, tmp_path):
    told, disturbances = told_of_a_meal("basal-bolus"), Disturbances(outages=3)
    silent = {seed: disturbances.draw(24, seed)[1] for seed in range(100)}
    seed = next(seed for seed, samples in silent.items() if ANNOUNCED in samples and max(samples) < 23)
    run = told.run(told.link(tmp_path), disturbances=disturbances, seed=seed)
    assert run.equal == [True] * 24
    assert run.late_boluses_mU == [bolus.trace.command_bolus_mU[ANNOUNCED]]
    assert not np.any(run.trace.bolus_mU[ANNOUNCED])


def test_a_suspending_pump_gives_nothing_without_an_answer(on_chip, tmp_path):
    run = on_chip.run(on_chip.link(tmp_path), disturbances=Disturbances(outages=6), seed=2, fallback="suspend")
    assert np.all(np.asarray(run.trace.command_mU_min)[~np.asarray(run.answered)] == 0.0)


def test_the_fallback_rate():
    pump = _Fallback("basal", 22.3)
    assert pump.rate_mU_min(40.0, 0.0) == 22.3
    assert pump.rate_mU_min(0.0, 25.0) == 0.0
    assert pump.rate_mU_min(0.0, 30.0) == 22.3
    assert _Fallback("suspend", 22.3).rate_mU_min(40.0, 0.0) == 0.0


def _asked(on_chip, link, seen, within_s=5.0):
    exchange = Exchange(link, on_chip.exported.source.design, on_chip.payloads.sizes)
    exchange.begin()
    return exchange, [exchange.decide(sample, payload, within_s) for sample, payload in enumerate(seen)]


@pytest.fixture
def seen(on_chip):
    readings = np.linspace(80.0, 140.0, 6)
    first = leaves_of(on_chip.stepper.reset(), on_chip.exported)
    return [on_chip.payloads.observation([np.float32(reading), *first[1:]]) for reading in readings]


def test_power_may_fail_after_any_byte_of_a_record(on_chip, seen, tmp_path):
    link = on_chip.link(tmp_path)
    try:
        exchange, before = _asked(on_chip, link, seen[:4])
        _, expected = _asked(on_chip, link, seen)
        exchange, before = _asked(on_chip, link, seen[:4])
        memory = (tmp_path / "nvm.bin").read_bytes()
        answers = dict(exchange.answers)
        for count in range(record_bytes(on_chip.exported.source, on_chip.payloads) + 1):
            link.power_off()
            (tmp_path / "nvm.bin").write_bytes(memory)
            link.power_on(Plan.CUT, count)
            exchange.answers = dict(answers)
            assert exchange.decide(4, seen[4]) == expected[4], count
            assert exchange.decide(5, seen[5]) == expected[5], count
        assert exchange.sessions == [0]
        assert exchange.contradictions == 0
        assert before == expected[:4]
    finally:
        link.close()


def test_a_chip_that_lost_its_memory_begins_anew(on_chip, seen, tmp_path):
    link = on_chip.link(tmp_path)
    try:
        exchange, _ = _asked(on_chip, link, seen[:3])
        link.power_off()
        memory = tmp_path / "nvm.bin"
        memory.write_bytes(b"\xff" * len(memory.read_bytes()))
        link.power_on()
        assert exchange.decide(3, seen[3]) is not None
        assert exchange.sessions == [0, 3]
    finally:
        link.close()


def test_one_damaged_record_is_made_again_from_the_other(on_chip, seen, tmp_path):
    link = on_chip.link(tmp_path)
    try:
        exchange, expected = _asked(on_chip, link, seen)
        link.power_off()
        memory = tmp_path / "nvm.bin"
        held = bytearray(memory.read_bytes())
        # START was record 1, so the last of the six samples is record 7, in the second place.
        held[len(held) // 2 + 30] ^= 1
        memory.write_bytes(bytes(held))
        link.power_on()
        assert exchange.ask_again(5) == expected[5]
        assert exchange.sessions == [0]
        assert exchange.contradictions == 0
    finally:
        link.close()


def test_a_chip_with_another_controller_is_refused(on_chip, tmp_path):
    link = on_chip.link(tmp_path)
    try:
        with pytest.raises(ValueError, match="write the firmware of this run to it"):
            Exchange(link, "0" * 64, on_chip.payloads.sizes).begin()
    finally:
        link.close()


class _Twice:
    """A chip that waits for sample 0 and sends each of its answers three times; a deaf one takes no observation."""

    deaf = False

    def __init__(self, exported, payloads):
        self.asked, self._answers = 0, b""
        self._hello = bytes.fromhex(exported.source.design) + struct.pack("<HHI", *payloads.sizes, 1000)
        self._decision = bytes(payloads.sizes[1])

    def send(self, data):
        [frame] = Decoder().feed(data)
        if frame.type == Type.OBSERVATION:
            if self.deaf:
                return
            self.asked += 1
            answer = Frame(Type.DECISION, frame.session, frame.sample, self._decision)
        else:
            asked = frame.sample if frame.type == Type.ASK else 0
            answer = Frame(Type.HELLO, frame.session, 0, self._hello + struct.pack("<I", asked))
        self._answers += 3 * answer.encoded()

    def receive(self, wait_s):
        told, self._answers = self._answers, b""
        return told

    def close(self):
        pass


def test_an_answer_that_comes_twice_asks_for_nothing(on_chip):
    line = _Twice(on_chip.exported, on_chip.payloads)
    _, answers = _asked(on_chip, line, [b""] * 50)
    assert None not in answers
    assert line.asked < 100  # a few greetings more; once, each repeated answer asked for another


class _Damaging(_Twice):
    """A chip of which every other answer is damaged."""

    damaged, received = False, 0

    def receive(self, wait_s):
        self.received += 1
        assert self.received < 1000, "nobody asks again"
        told = super().receive(wait_s)
        self.damaged ^= bool(told)
        return b"GL\x01" + bytes(17) if told and self.damaged else told


def test_a_damaged_answer_is_asked_for_again_at_once(on_chip):
    line = _Damaging(on_chip.exported, on_chip.payloads)
    exchange = Exchange(line, on_chip.exported.source.design, on_chip.payloads.sizes, clock=lambda: 0.0)
    exchange.begin()
    assert all(exchange.decide(sample, b"") is not None for sample in range(10))


def test_a_damaged_frame_is_answered_by_a_greeting(on_chip, tmp_path):
    link = on_chip.link(tmp_path)
    try:
        decoder, greetings = Decoder(), 0
        link.send(Frame(Type.ASK, sample=7).encoded()[:-1] + b"!")
        while greetings < 2 and (received := link.receive(10.0)):  # the first one is that of its start
            greetings += sum(frame.type == Type.HELLO for frame in decoder.feed(received))
        assert greetings == 2
    finally:
        link.close()


def test_a_frame_is_sent_again_after_the_usual_time_of_an_answer():
    patience = _Patience()
    assert patience.wait_s == 0.02
    patience.repeated()
    assert patience.wait_s == 0.04
    for _ in range(60):
        patience.answered(0.03)
    assert patience.wait_s == pytest.approx(0.03, rel=1e-3)
    patience.answered(0.05)
    assert patience.wait_s == pytest.approx(0.03 + 0.02 / 8 + 4.0 * 0.02 / 4.0, rel=1e-3)
    for _ in range(60):
        patience.answered(1e-5)
    assert patience.wait_s == 0.002
    for _ in range(20):
        patience.repeated()
    assert patience.wait_s == 1.0


class _Nobody:
    """A line with nobody at its end."""

    def send(self, data):
        pass

    def receive(self, wait_s):
        return b""


def test_nobody_at_the_line_is_told(on_chip):
    times = iter(np.arange(0.0, 1e6))
    exchange = Exchange(_Nobody(), on_chip.exported.source.design, on_chip.payloads.sizes, clock=lambda: next(times))
    with pytest.raises(ValueError, match="the chip did not answer within 10 s"):
        exchange.begin()


def test_a_serial_port(on_chip, undisturbed, tmp_path):
    """The firmware of this computer behind a pseudo-terminal, as a board behind its port."""
    on_chip.link(tmp_path).close()
    ours, theirs = os.openpty()
    name = os.ttyname(theirs)
    link = SerialLink(name)  # makes the line raw, before the firmware speaks
    chip = subprocess.Popen(
        [str(tmp_path / "firmware")], cwd=tmp_path, stdin=ours, stdout=ours, stderr=subprocess.DEVNULL
    )
    try:
        run = on_chip.run(link, disturbances=Disturbances(damaged=3, lost=2, doubled=2, late=2))
    finally:
        chip.kill()
        chip.wait()
        os.close(ours)
        os.close(theirs)
    assert equal(run.trace, undisturbed.trace)


def test_a_chip_that_does_not_answer_the_first_observation_is_refused(on_chip):
    line = _Twice(on_chip.exported, on_chip.payloads)
    line.deaf = True
    with pytest.raises(ValueError, match=r"within 0\.5 s; a step may take longer than its watchdog allows, 1000 ms"):
        on_chip.run(line, pace=Pace(5.0, longest_answer_s=0.5))


def test_no_step_that_was_counted_is_a_hang_to_the_watchdog():
    """The longest steps of all controllers on emulated chips, of which QEMU counts 64 ns for each instruction."""
    counted = json.loads((Path(__file__).parents[2] / "docs" / "chip_results.json").read_text())
    of_chips = {name: [cell for chip, cell in of["cells"].items() if chip in CHIPS] for name, of in counted.items()}
    assert any(of_chips.values())
    for name, cells in of_chips.items():
        for cell in cells:
            assert 2.0 * cell["instructions"] * 64e-6 < WATCHDOG_MS[name.split()[-1]], name


def test_real_time_waits_for_each_sample():
    now = [100.0]

    def sleep(seconds):
        now[0] += seconds

    pace = Pace(5.0, 60.0, clock=lambda: now[0], sleep=sleep)
    for sample in range(3):
        pace.wait_for(sample)
        assert now[0] == 100.0 + 300.0 * sample
        now[0] += 7.0
    assert pace.answer_within_s == 10.0
    assert Pace(0.1, 60.0).answer_within_s == 3.0


def test_closing_the_link_ends_the_chip(on_chip, tmp_path):
    link = on_chip.link(tmp_path)
    process = link._process
    link.close()
    assert process.poll() is not None


@pytest.mark.parametrize(
    "chip",
    ["cortex-m4f", pytest.param("cortex-m7", marks=pytest.mark.long), pytest.param("rv32", marks=pytest.mark.long)],
)
def test_an_emulated_chip_gives_the_bits_of_this_computer(on_chip, undisturbed, tmp_path, chip):
    if CHIPS[chip].missing:
        pytest.skip(CHIPS[chip].missing)
    disturbances = Disturbances(power_cuts=6, hangs=1, damaged=3, lost=1, doubled=2, late=2)
    run = on_chip.run(on_chip.link(tmp_path, chip, "-Werror"), disturbances=disturbances, seed=1)
    assert run.equal == [True] * 24
    assert equal(run.trace, undisturbed.trace)


@pytest.mark.long
@pytest.mark.parametrize("chip", CHIPS)
def test_an_emulated_chip_gives_the_boluses_of_this_computer(told_of_a_meal, bolus, tmp_path, chip):
    if CHIPS[chip].missing:
        pytest.skip(CHIPS[chip].missing)
    told = told_of_a_meal("basal-bolus")
    run = told.run(told.link(tmp_path, chip, "-Werror"), disturbances=Disturbances(power_cuts=6, doubled=6), seed=1)
    assert run.equal == [True] * 24
    assert equal(run.trace, bolus.trace)


@pytest.mark.long
def test_a_day_with_a_thousand_power_cuts(on_chip, tmp_path):
    day = on_chip.lasting(1440.0)
    calm = day.run(day.link(tmp_path / "calm"))
    disturbances = Disturbances(power_cuts=1000, hangs=5, damaged=200, lost=50, doubled=100, late=100)
    run = day.run(day.link(tmp_path / "wild"), disturbances=disturbances, seed=11)
    assert run.equal == [True] * 288
    assert equal(run.trace, calm.trace)


def call(*arguments):
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    return left.value.code


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--chip", "z80"), "the chip is 'z80'; the known ones are: host, cortex-m4f, cortex-m7, rv32"),
        (("--chip", "/dev/nothing"), "the serial port /dev/nothing cannot be opened"),
        (("--chip", "/dev/null"), "/dev/null is no serial port"),
        (("--chip", "/dev/ttyACM0", "--power-cuts", "3"), "let --power-cuts and --hangs be 0"),
        (("--outages", "120"), "give 119 or fewer"),
        (("--lost", "-1"), "--lost"),
        (("--fallback", "bolus"), "--fallback"),
        (("--precision", "float16"), "--precision"),
    ],
)
def test_mistakes_are_told_in_a_sentence(arguments, told, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call("hil", "--controller", "basal", *arguments) == 2
    assert told in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(bool(CHIPS["cortex-m4f"].missing), reason=CHIPS["cortex-m4f"].missing)
def test_without_the_library_of_the_cross_compiler_its_package_is_named(tmp_path, monkeypatch):
    compiler = tmp_path / "arm-none-eabi-gcc"
    compiler.write_text("#!/bin/sh\necho 'fatal error: string.h: No such file or directory' >&2\nexit 1\n")
    compiler.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    assert CHIPS["cortex-m4f"].missing == (
        "the C library of arm-none-eabi-gcc is not installed; Debian's package libnewlib-dev brings it"
    )


def test_without_the_emulator_its_package_is_named(capsys, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert call("hil", "--controller", "basal", "--chip", "cortex-m4f") == 2
    assert "Debian's package gcc-arm-none-eabi brings it" in capsys.readouterr().err
