"""A small Nightscout site on this machine, which filters and pages as Nightscout does."""

import json
import threading
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

from device_files import nightscout_entries, nightscout_treatments

TOKEN = "reader-0123456789abcdef"
START = datetime(2024, 3, 13, 0, 3)
UNTIL = datetime(2024, 3, 14, tzinfo=UTC)
PROFILE = [{"defaultProfile": "Default", "store": {"Default": {"timezone": "Europe/Berlin", "basal": []}}}]
TREATMENTS = json.loads(
    nightscout_treatments(
        (START + timedelta(minutes=30), {"eventType": "Meal Bolus", "insulin": 4.5, "carbs": 45.0}),
        (START - timedelta(days=30), {"eventType": "Meal Bolus", "insulin": 9.0}),
    )
)


class Server:
    """A site: its data, its token, what it answers instead, and what it was asked."""

    def __init__(self):
        entries = json.loads(nightscout_entries(40, START))
        self.data = {"entries": entries, "treatments": TREATMENTS, "profile": PROFILE}
        self.token, self.instead, self.asked = None, None, []

    def answer(self, method, path):
        self.asked.append((method, path))
        parts, query = urlsplit(path), {key: value[0] for key, value in parse_qs(urlsplit(path).query).items()}
        if self.instead is not None:
            return self.instead
        if self.token and query.get("token") != self.token:
            return 401, b'{"status": 401}', {}
        what = parts.path.removeprefix("/api/v1/").removesuffix(".json")
        items = self.data.get(what)
        if items is None:
            return 404, b"", {}
        key = {"entries": "date", "treatments": "created_at"}.get(what)
        if key:
            kind = int if key == "date" else str
            low, high = (kind(query[f"find[{key}][{end}]"]) for end in ("$gte", "$lte"))
            items = sorted((i for i in items if low <= i[key] <= high), key=lambda i: i[key], reverse=True)
            items = items[: int(query["count"])]
        return 200, json.dumps(items).encode(), {}


@contextmanager
def running_site():
    """A server with its site, which tells what it was asked."""
    server = Server()

    class Handler(BaseHTTPRequestHandler):
        def handle_any(self):
            code, body, headers = server.answer(self.command, self.path)
            self.send_response(code)
            for name, value in headers.items():
                self.send_header(name, value)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        do_GET = do_POST = do_PUT = do_DELETE = handle_any

        def log_message(self, *_):
            pass

    running = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=running.serve_forever, daemon=True)
    thread.start()
    server.url = f"http://127.0.0.1:{running.server_port}"
    yield server
    running.shutdown()
    running.server_close()
    thread.join()
