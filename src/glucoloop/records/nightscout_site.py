"""Reading of a record from a Nightscout site over the network, by GET alone: entries, treatments and the profile.

Addresses and filters are those of version 1 of Nightscout's interface, ``/api/v1/entries.json`` and so on. Nothing but
the filters and the token is sent, and only to the site itself: a redirection is refused.
"""

from __future__ import annotations

import json
import urllib.parse
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime, timedelta
from typing import Any, Final

from glucoloop.records.answers import Answers
from glucoloop.records.extract import Account
from glucoloop.records.file_text import FileText, json_of
from glucoloop.records.nightscout import Nightscout
from glucoloop.records.nightscout_profile import profiles_of, zones_of
from glucoloop.records.record import DeviceRecord
from glucoloop.records.tidy import record_of, settled
from glucoloop.records.web_request import Allowance, StatusError, address_of, get
from glucoloop.refusal import Refusal

TOKEN_VARIABLE: Final = "GLUCOLOOP_NIGHTSCOUT_TOKEN"
"""Environment variable of the token, which no command line or file may hold."""
PAGE: Final = 10_000
"""Number of entries asked for at once."""
MAX_DAYS: Final = 3660
_MAX_PAGES: Final = 10_000
_LOOPBACK: Final = ("localhost", "127.0.0.1", "::1")


def read_nightscout(
    url: str,
    *,
    days: int = 14,
    until: datetime | None = None,
    token: str | None = None,
    time_zone: str | None = None,
    allowance: Allowance | None = None,
) -> DeviceRecord:
    """Read the record of a person from a Nightscout site; nothing there is changed.

    Parameters
    ----------
    url : str
        Address of the site, as ``https://my-site.example``.
    days : int
        Number of days before `until`.
    until : datetime, optional
        Moment with a time zone up to which the record goes; now by default.
    token : str, optional
        Access token of the site with the role ``readable``, where it asks for one.
    time_zone : str, optional
        Time zone of the person; that of the site's profile by default.
    allowance : Allowance, optional
        Time and bytes that the requests may take: by default 120 s and 200 MB each, and half an hour and 2 GB in all.

    Returns
    -------
    DeviceRecord
        The record, as `read_record` gives it of files.

    Raises
    ------
    Refusal
        If the site does not answer, refuses, answers anything but Nightscout's JSON, or has nothing for these days.
    """
    if not 1 <= days <= MAX_DAYS:
        raise Refusal(f"days is {days}; give 1 to {MAX_DAYS}")
    site = _Site(url, token, allowance or Allowance())
    end = until or datetime.now(UTC)
    span = (end - timedelta(days=days), end)
    entries = list(site.all_of("entries", "date", lambda at: str(round(1000.0 * at.timestamp())), span))
    treatments = list(site.all_of("treatments", "created_at", _utc_text, span))
    profiles = profiles_of(FileText(json.dumps(site.page("profile", {}))))
    answers, account, frames = Answers(time_zone=time_zone, basal_profiles=tuple(profiles)), Account(), []
    for items in (entries, treatments):
        if items:
            extract = Nightscout().rows(FileText(json.dumps(items)), answers)
            frames.append(settled(extract, extract.frame, answers, account))
    if not frames:
        raise Refusal(f"{site.name} has no entries and no treatments in these {days} days; ask for more days")
    return record_of(frames, zones_of(profiles), answers, account)


class _Site:
    """A site, asked page by page."""

    def __init__(self, url: str, token: str | None, allowance: Allowance) -> None:
        self._address = address_of(
            url, f"leave that out, and put the token into the environment variable {TOKEN_VARIABLE}"
        )
        self.name, self._token, self._allowance = self._address.host, token, allowance
        if token and self._address.scheme != "https" and self.name not in _LOOPBACK:
            raise Refusal(f"{self.name} would get the token unencrypted; give an address with https")

    def page(self, what: str, query: Mapping[str, str]) -> list[Any]:
        """One page of entries, treatments or profiles."""
        with_token = {**query, "token": self._token} if self._token else query
        address = self._address.text(f"/api/v1/{what}.json?{urllib.parse.urlencode(with_token)}")
        try:
            data = get(address, self._allowance, {"Accept": "application/json"})
            items = json_of(data.decode("utf-8"))
        except StatusError as error:
            raise Refusal(f"{self.name} {self._on_status(error.status)}") from None
        except UnicodeDecodeError:
            items = None
        except Refusal as error:
            raise Refusal(f"{self.name} {error}") from None
        if not isinstance(items, list):
            raise Refusal(
                f"{self.name} answers {what}.json with something else than a list in JSON; give the address of a "
                "Nightscout site"
            )
        return items

    def all_of(
        self, what: str, key: str, text: Callable[[datetime], str], span: tuple[datetime, datetime]
    ) -> Iterator[dict[str, Any]]:
        """Items of a span, newest first; a page begins with the moment that ends the one before."""
        known, last = set[str](), text(span[1])
        for _ in range(_MAX_PAGES):
            parameters = {"count": str(PAGE), f"find[{key}][$gte]": text(span[0]), f"find[{key}][$lte]": last}
            items = [item for item in self.page(what, parameters) if isinstance(item, dict)]
            new = [item for item in items if _identity(item) not in known]
            yield from new
            known.update(map(_identity, new))
            moments = [str(item[key]) for item in new if isinstance(item.get(key), int | float | str) and item[key]]
            if not moments:
                return
            last = min(moments, key=lambda moment: (len(moment), moment) if key == "date" else (0, moment))
        raise Refusal(f"{self.name} answers with ever more {what}; ask for fewer days")

    def _on_status(self, status: int) -> str:
        if status in (401, 403):
            given = "does not accept the token" if self._token else "asks for a token"
            return f"{given}; put one with the role readable into the environment variable {TOKEN_VARIABLE}"
        if 300 <= status < 400:
            return "points to another address; give that one"
        return f"refuses with status {status}; give the address of a Nightscout site, or try later"


def _identity(item: Mapping[str, Any]) -> str:
    return str(item.get("_id") or json.dumps(item, sort_keys=True))


def _utc_text(at: datetime) -> str:
    return f"{at.astimezone(UTC):%Y-%m-%dT%H:%M:%S.000Z}"
