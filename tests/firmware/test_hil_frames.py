"""Frames of the link to a chip: nothing that is damaged is taken, in Python as in the C of the firmware."""

import ctypes
import dataclasses
import shutil
import subprocess
import zlib

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from glucoloop.firmware.checks import _misra_of, firmware_proved
from glucoloop.firmware.hil.build import _WARNINGS, HOST, files, portable_files
from glucoloop.firmware.hil.protocol import _MAX_FRAME_BYTES, _MAX_PAYLOAD_BYTES, Decoder, Frame, Type
from glucoloop.native.targets.c.host import compiler

WORDS = st.integers(0, 2**32 - 1)
FRAMES = st.builds(Frame, st.integers(0, 255), WORDS, WORDS, st.binary(max_size=_MAX_PAYLOAD_BYTES))
NOISE = st.binary(max_size=80) | st.lists(st.sampled_from([b"G", b"GL", b"GL\x01", b"\x00"])).map(b"".join)


@pytest.fixture(scope="module")
def in_c(tmp_path_factory, on_chip):
    """Encoder and decoder of the firmware, called from here."""
    if compiler() is None:
        pytest.skip("no C compiler: install gcc")
    folder = tmp_path_factory.mktemp("frames")
    for name, text in files(on_chip.exported, HOST).items():
        (folder / name).write_text(text)
    command = [compiler(), *_WARNINGS, "-Werror", "-shared", "-fPIC", "-o", "frame.so", "frame.c"]
    subprocess.run(command, cwd=folder, check=True)
    code = ctypes.CDLL(str(folder / "frame.so"))
    code.hil_next.restype = ctypes.c_bool
    return code


class _Frame(ctypes.Structure):
    _fields_ = [
        ("session", ctypes.c_uint32),
        ("sample", ctypes.c_uint32),
        ("length", ctypes.c_uint16),
        ("type", ctypes.c_uint8),
        ("payload", ctypes.c_uint8 * _MAX_PAYLOAD_BYTES),
    ]


class _Decoder(ctypes.Structure):
    _fields_ = [
        ("size", ctypes.c_uint32),
        ("refused", ctypes.c_uint32),
        ("held", ctypes.c_uint8 * _MAX_FRAME_BYTES),
    ]


def decoded_in_c(code, data):
    decoder, frame, found = _Decoder(), _Frame(), []
    for byte in data:
        code.hil_push(ctypes.byref(decoder), ctypes.c_uint8(byte))
        while code.hil_next(ctypes.byref(decoder), ctypes.byref(frame)):
            found.append(Frame(frame.type, frame.session, frame.sample, bytes(frame.payload[: frame.length])))
        assert decoder.size < _MAX_FRAME_BYTES
    return found, decoder.refused


def decoded(data):
    decoder = Decoder()
    return list(decoder.feed(data)), decoder.refused


def test_the_layout_is_the_documented_one():
    told = Frame(Type.DECISION, session=0x01020304, sample=0x0A0B0C0D, payload=b"\x07\x08").encoded()
    head = bytes.fromhex("474c0112 04030201 0d0c0b0a 0200 0000")
    assert told[:16] == head
    assert told[16:20] == zlib.crc32(head).to_bytes(4, "little")
    assert told[20:22] == b"\x07\x08"
    assert told[22:] == zlib.crc32(told[:22]).to_bytes(4, "little")


@given(FRAMES)
def test_c_writes_the_same_bytes(in_c, frame):
    payload = (ctypes.c_uint8 * _MAX_PAYLOAD_BYTES)(*frame.payload)
    room = (ctypes.c_uint8 * _MAX_FRAME_BYTES)()
    held = _Frame(frame.session, frame.sample, len(frame.payload), frame.type, payload)
    size = in_c.hil_encode(ctypes.byref(held), room)
    assert bytes(room[:size]) == frame.encoded()


@given(st.lists(FRAMES | NOISE, max_size=6))
@example([b"GL\x01" * 100, Frame(1)])
def test_any_bytes_give_the_same_frames_in_both(in_c, parts):
    data = b"".join(part.encoded() if isinstance(part, Frame) else part for part in parts)
    found, refused = decoded(data)
    assert decoded_in_c(in_c, data) == (found, refused)


@given(FRAMES, FRAMES)
def test_two_frames_arrive_however_they_are_cut(first, second):
    data, decoder = first.encoded() + second.encoded(), Decoder()
    pieces = [data[i : i + 7] for i in range(0, len(data), 7)]
    assert [frame for piece in pieces for frame in decoder.feed(piece)] == [first, second]


@given(FRAMES, st.data())
def test_one_damaged_byte_is_refused_and_the_next_frame_arrives(in_c, frame, data):
    whole = frame.encoded()
    at = data.draw(st.integers(0, len(whole) - 1))
    damaged = bytearray(whole)
    damaged[at] ^= data.draw(st.integers(1, 255))
    # As much as a damaged length can ask for may have to come before the damage shows.
    after = dataclasses.replace(frame, type=Type.ASK, payload=b"")
    sent = bytes(damaged) + after.encoded() * (1 + _MAX_FRAME_BYTES // len(after.encoded()))
    for found, _ in (decoded(sent), decoded_in_c(in_c, sent)):
        assert found
        assert set(found) == {after}


@given(FRAMES)
def test_every_damaged_byte_of_a_frame_is_refused(frame):
    whole = frame.encoded()
    for at in range(len(whole)):
        assert not decoded(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])[0]


@pytest.mark.long
@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="needs cppcheck (Debian: apt install cppcheck)")
def test_no_required_rule_of_misra_is_broken_by_the_files_for_every_board(on_chip):
    check = _misra_of(portable_files(on_chip.exported), "hil.c", "frame.c", "store.c")
    assert check.holds, check.finding
    assert check.measured["advisory"]  # the add-on did run


@pytest.mark.skipif(shutil.which("frama-c") is None, reason="needs Frama-C (Debian: apt install frama-c-base)")
def test_no_bytes_on_the_line_or_in_memory_make_a_run_time_error(on_chip):
    files = portable_files(on_chip.exported)
    check = firmware_proved(files)
    assert check.holds, check.finding
    unguarded = files["frame.c"].replace("if (decoder->size < HIL_FRAME_MAX)", "if (true)")
    assert firmware_proved({**files, "frame.c": unguarded}).holds is False


@pytest.mark.long
@pytest.mark.skipif(shutil.which("frama-c") is None, reason="needs Frama-C (Debian: apt install frama-c-base)")
def test_no_bytes_make_a_run_time_error_where_boluses_are_decided(told_of_a_meal):
    check = firmware_proved(portable_files(told_of_a_meal("basal-bolus").exported))
    assert check.holds, check.finding
