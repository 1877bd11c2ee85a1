"""A site that never ends what it sends, and addresses and errors that hold the token."""

import itertools
import socket
import threading
from contextlib import contextmanager

import pytest

import glucoloop as gl
from glucoloop.records import web_request
from glucoloop.records.nightscout_site import read_nightscout
from glucoloop.records.web_request import Allowance
from nightscout_server import TOKEN, UNTIL

HEAD = b"HTTP/1.1 200 OK\r\nContent-Length: 1000000\r\n\r\n"
ENDLESS = {
    "silence": ([], b""),
    "100 Continue for ever": ([], b"HTTP/1.1 100 Continue\r\n\r\n"),
    "a header a letter at a time": ([b"HTTP/1.1 200 OK\r\nX: "], b"x"),
    "a body a byte at a time": ([HEAD], b" "),
    "chunks of a byte": ([b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"], b"1\r\n[\r\n"),
    "a refusal that never ends": ([b"HTTP/1.1 401 No\r\nX: "], b"x"),
}


@contextmanager
def sending(first, again, most=200, pause_s=0.05):
    """A server on this machine that sends to each of a few callers some bytes, and others again and again."""
    ended = threading.Event()
    server = socket.create_server(("127.0.0.1", 0))
    server.settimeout(0.1)

    def serve(caller):
        with caller:
            try:
                caller.recv(10_000)
                for part in itertools.chain(first, itertools.repeat(again, most)):
                    caller.sendall(part)
                    if ended.wait(pause_s):
                        return
            except OSError:
                return

    def accept():
        callers = []
        while not ended.is_set() and len(callers) < 10:
            try:
                callers.append(threading.Thread(target=serve, args=(server.accept()[0],), daemon=True))
            except TimeoutError:
                continue
            callers[-1].start()
        for caller in callers:
            caller.join()

    accepting = threading.Thread(target=accept, daemon=True)
    accepting.start()
    yield f"http://127.0.0.1:{server.getsockname()[1]}"
    ended.set()
    accepting.join()
    server.close()


@pytest.mark.parametrize("what", ENDLESS)
def test_a_request_ends_whatever_is_sent(what):
    with (
        sending(*ENDLESS[what]) as url,
        pytest.raises(gl.Refusal, match=r"^127\.0\.0\.1 takes more than 0\.7 s for one answer; try later"),
    ):
        read_nightscout(url, days=2, until=UNTIL, allowance=Allowance(each_s=0.7))


def test_the_limit_of_one_operation_may_come_before_that_of_the_answer(monkeypatch):
    """Both are the same in so short a time, and which is first is a matter of chance."""
    monkeypatch.setattr(web_request._Deadline, "_end", lambda deadline: None)
    with (
        sending(*ENDLESS["silence"]) as url,
        pytest.raises(gl.Refusal, match=r"^127\.0\.0\.1 takes more than 0\.7 s for one answer; try later"),
    ):
        read_nightscout(url, days=2, until=UNTIL, allowance=Allowance(each_s=0.7))


def test_a_handshake_ends():
    with (
        sending([], b"\x16", pause_s=0.05) as url,
        pytest.raises(gl.Refusal, match=r"^127\.0\.0\.1 (takes more than 0\.7 s|gives no answer)"),
    ):
        read_nightscout(url.replace("http", "https"), days=2, until=UNTIL, allowance=Allowance(each_s=0.7))


def test_the_bytes_of_an_answer_and_of_all_are_bounded():
    body = b"[" + b" " * 5000 + b"]"
    answer = b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n" + body
    with sending([answer], b"", most=0) as url:
        for allowance in (Allowance(each_bytes=4000), Allowance(all_bytes=4000), Allowance(all_bytes=9000)):
            with pytest.raises(gl.Refusal, match=r"^127\.0\.0\.1 answers with more than \d+ bytes; ask for fewer days"):
                read_nightscout(url, days=2, until=UNTIL, allowance=allowance)


def test_the_time_of_all_requests_is_bounded():
    with (
        sending([b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n[]"], b"", most=0) as url,
        pytest.raises(gl.Refusal, match="has not sent everything within 0 s; ask for fewer days"),
    ):
        read_nightscout(url, days=2, until=UNTIL, allowance=Allowance(all_s=0.0))


WRONG = (
    "http://[::1",
    "http://::1]",
    "http://[nonsense]",
    "http://127.0.0.1:1/a b",
    "http://127.0.0.1 :1",
    "http://127.0.0.1:port",
    "http://127.0.0.1:99999",
    "http://127.0.0.1\n:1",
    "http://127.0.0.1:1/\x1b[31m",
    "http://127.0.0.1:1/\u00e9",
    "http://exa\u2100mple",
    "http://" + "\u00e9" * 80,
    "http://a%20b",
    "http://\ud800",
    "http://",
    "\0",
    "",
)


@pytest.mark.parametrize("url", WRONG)
def test_what_is_no_address_is_refused_without_a_word_of_it(url):
    with pytest.raises(gl.Refusal) as refusal:
        read_nightscout(url, token=TOKEN)
    assert str(refusal.value) == "what is given is no address of a site; give one like https://my-site.example"


@pytest.mark.parametrize(
    "head", [b"\x1b[31mno HTTP\r\n", b"HTTP/1.1 x\r\n", b"HTTP/1.1 200 OK\r\n" + b"a: b\r\n" * 200]
)
def test_an_error_of_the_library_is_told_in_words_of_our_own(head):
    with sending([head], b"", most=0) as url, pytest.raises(gl.Refusal) as refusal:
        read_nightscout(url, days=2, until=UNTIL, token=TOKEN)
    assert str(refusal.value) == (
        "127.0.0.1 gives no answer (it does not keep to HTTP); check the address and the network"
    )


def test_odd_values_of_a_site_are_read_or_refused():
    odd = b'[{"store": {"a": 1}, "defaultProfile": [], "date": {}, "_id": "\\ud800"}, {"date": "\\ud800", "sgv": []}]'
    answer = b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n" + odd
    with sending([answer], b"", most=0) as url, pytest.raises(gl.Refusal, match="nothing in it can be used"):
        read_nightscout(url, days=2, until=UNTIL)
