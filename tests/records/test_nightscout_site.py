"""Fetching from a Nightscout site, against a small server on this machine that filters and pages as Nightscout does."""

import json

import pytest

import glucoloop as gl
from glucoloop.records import nightscout_site
from glucoloop.records.nightscout_site import read_nightscout
from nightscout_server import TOKEN, TREATMENTS, UNTIL, running_site


@pytest.fixture
def site():
    with running_site() as site:
        yield site


def test_a_site_gives_the_record_of_its_files(site, tmp_path, monkeypatch):
    monkeypatch.setattr(nightscout_site, "PAGE", 7)
    found = read_nightscout(site.url, days=2, until=UNTIL)
    (tmp_path / "entries.json").write_text(json.dumps(site.data["entries"]))
    (tmp_path / "treatments.json").write_text(json.dumps(TREATMENTS[:1]))
    files = gl.read_record(tmp_path / "entries.json", tmp_path / "treatments.json", time_zone="Europe/Berlin")
    assert found.frame.equals(files.frame)
    assert (found.rows, found.rows_used) == (41, 41)
    assert "Europe/Berlin is the time zone that the files tell; it holds for all times." in found.notes
    assert len(site.asked) > 6  # pages
    assert {method for method, _ in site.asked} == {"GET"}


def test_readings_of_the_same_moment_at_the_end_of_a_page_are_all_there(site, monkeypatch):
    monkeypatch.setattr(nightscout_site, "PAGE", 3)
    twin = {**site.data["entries"][1], "_id": "twin", "device": "xDrip-Libre2"}
    site.data["entries"].insert(1, twin)
    assert read_nightscout(site.url, days=2, until=UNTIL).rows == 42


def test_a_zone_that_is_given_goes_before_that_of_the_profile(site):
    site.data["profile"] = [{"store": {"x": {"timezone": "nowhere"}}}]
    assert read_nightscout(site.url, days=2, until=UNTIL).frame["utc_offset_min"][0] == 60  # as the uploader tells it
    found = read_nightscout(site.url, days=2, until=UNTIL, time_zone="America/New_York")
    assert found.frame["utc_offset_min"][0] == -240


@pytest.mark.long
@pytest.mark.parametrize(
    ("instead", "sentence"),
    [
        ((401, b"", {}), "asks for a token; put one with the role readable into the environment variable"),
        ((500, b"", {}), "refuses with status 500"),
        ((404, b"", {}), "refuses with status 404"),
        ((302, b"", {"Location": "http://127.0.0.1:1/"}), "points to another address; give that one"),
        ((200, b"<html>hello", {}), "something else than a list in JSON"),
        ((200, b'{"status": "ok"}', {}), "something else than a list in JSON"),
        ((200, b"[" * 100_000, {}), "something else than a list in JSON"),
        ((200, b"[]", {}), "has no entries and no treatments in these 2 days"),
        ((200, b'[{"sgv": 100', {}), "something else than a list in JSON"),
    ],
)
def test_what_a_site_cannot_answer_is_a_sentence(site, instead, sentence):
    site.instead = instead
    with pytest.raises(gl.Refusal) as refusal:
        read_nightscout(site.url, days=2, until=UNTIL)
    assert sentence in str(refusal.value)


def test_no_site_at_all_is_a_sentence(site):
    with pytest.raises(gl.Refusal, match=r"127\.0\.0\.1 gives no answer \(.*refused"):
        read_nightscout("http://127.0.0.1:1", days=2, until=UNTIL)


@pytest.mark.parametrize(
    ("url", "sentence"),
    [
        ("my-site", "what is given is no address of a site"),
        ("file:///etc/passwd", "what is given is no address of a site"),
        (f"https://site.example/?token={TOKEN}", "put the token into the environment variable"),
        (f"https://{TOKEN}@site.example", "put the token into the environment variable"),
        ("http://site.example", "would get the token unencrypted"),
    ],
)
def test_an_address_that_would_give_a_token_away_is_refused(url, sentence):
    with pytest.raises(gl.Refusal) as refusal:
        read_nightscout(url, token=TOKEN)
    assert sentence in str(refusal.value)
    assert TOKEN not in str(refusal.value)
