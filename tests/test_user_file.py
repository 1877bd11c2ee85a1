"""What is no regular file is refused in a sentence, and nobody is waited for."""

import contextlib
import os
import socket
import sys
from pathlib import Path

import pytest

import glucoloop as gl
from glucoloop.situations.toml import read_file
from glucoloop.storage.model_file import read_model
from glucoloop.user_file import read_regular

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pipes and sockets have no names in folders there")
READERS = {
    "record": gl.read_record,
    "model": read_model,
    "configuration": lambda path: read_file(str(path)),
}


@contextlib.contextmanager
def pipe(place):
    os.mkfifo(place)
    yield place


@contextlib.contextmanager
def link_to_a_pipe(place):
    os.mkfifo(place.with_name("pipe"))
    place.symlink_to(place.with_name("pipe"))
    yield place


@contextlib.contextmanager
def socket_of_unix(place):
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(os.path.relpath(place))  # a name of a socket is at most 108 letters
        yield place


@contextlib.contextmanager
def device(place):
    place.symlink_to("/dev/zero")
    yield place


@pytest.mark.parametrize(
    ("made", "kind"), [(pipe, "a pipe"), (link_to_a_pipe, "a pipe"), (socket_of_unix, "a socket"), (device, "a device")]
)
@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_what_is_no_file_is_refused_at_once(tmp_path, monkeypatch, made, kind, read):
    monkeypatch.chdir(tmp_path)
    with made(tmp_path / "odd") as place, pytest.raises(gl.Refusal, match=f"it is {kind}, not a file; write what"):
        read(place)


def test_no_more_than_a_byte_beyond_the_bound_is_read(tmp_path):
    place = tmp_path / "file"
    place.write_bytes(b"x" * 100)
    assert read_regular(place, 10) == b"x" * 11
    assert read_regular(place, 100) == b"x" * 100
    with pytest.raises(gl.Refusal, match="it is a folder; name a file in it"):
        read_regular(tmp_path, 10)
    with pytest.raises(gl.Refusal, match="its name holds a NUL character"):
        read_regular(Path("a\0b"), 10)
