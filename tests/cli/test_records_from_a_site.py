"""The command that fetches a record from a Nightscout site."""

from datetime import UTC, datetime, timedelta

import pytest

from device_files import NAME, SERIAL
from glucoloop.records.nightscout_site import TOKEN_VARIABLE
from nightscout_server import START, TOKEN, running_site


def test_the_command_fetches_with_the_token_and_writes_it_nowhere(glucoloop, tmp_path, monkeypatch):
    later = datetime.now(UTC).replace(tzinfo=None) - START - timedelta(hours=5)
    with running_site() as site:
        site.token = TOKEN
        for entry in site.data["entries"]:
            entry["date"] += int(later.total_seconds() * 1000)
        call = ("records", "--from", "nightscout", site.url, "--out", "record.parquet", "--json")
        assert "asks for a token" in glucoloop(*call).err
        monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
        answer = glucoloop(*call)
        monkeypatch.setenv(TOKEN_VARIABLE, "another")
        refused = glucoloop(*call, "--overwrite")
    assert answer.code == 0, answer.err
    assert answer.json["rows"] == 40
    for hidden in (TOKEN, NAME, SERIAL, "127.0.0.1"):
        assert hidden not in answer.out
        assert hidden.encode() not in (tmp_path / "record.parquet").read_bytes()
    assert refused.code == 2
    assert "127.0.0.1 does not accept the token" in refused.err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--from", "dexcom", "https://a.example"), "--from is 'dexcom'; the one kind of site is nightscout"),
        (("--from", "nightscout", "https://a.example", "https://b.example"), "has 2 addresses"),
        (("--from", "nightscout", "https://a.example", "--dates", "day-first"), "--dates is for files"),
        (("--from", "nightscout", "https://a.example", "--days", "x"), "--days is 'x'"),
        (("--from", "nightscout", "https://a.example", "--days", "0"), "days is 0; give 1 to 3660"),
        (("a.csv", "--days", "3"), "--days is for a site"),
    ],
)
def test_what_cannot_be_fetched_is_refused(refused, arguments, sentence):
    assert sentence in refused("records", *arguments)
