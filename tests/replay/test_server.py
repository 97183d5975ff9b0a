"""Who is answered by the server of a replay: who names it as it was bound, and no page from elsewhere."""

from __future__ import annotations

import http.client
import socket
import threading
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from cyclekit.errors import CyclekitError
from cyclekit.replay import server as module
from cyclekit.replay.server import RECORDING, ReplayServer, serve

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def serving(folder: Path, bind: str = "127.0.0.1") -> Iterator[ReplayServer]:
    (folder / "x.rrd").write_bytes(b"who was where")
    with ReplayServer(bind, 0, folder / "x.rrd", {"/": b"page"}) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server
        server.shutdown()


def asked(server: ReplayServer, headers: list[tuple[str, str]], path: str = RECORDING, to: str = "127.0.0.1"):
    caller = http.client.HTTPConnection(to, server.server_address[1], timeout=20)
    caller.putrequest("GET", path, skip_host=True)
    for name, value in headers:
        caller.putheader(name, value.replace("PORT", str(server.server_address[1])))
    caller.endheaders()
    answer = caller.getresponse()
    found = answer.status, answer.read(), answer.headers
    caller.close()
    return found


@pytest.mark.parametrize("host", ["127.0.0.1:PORT", "localhost:PORT", "LOCALHOST", "[::1]:PORT", "localhost:8000"])
def test_who_names_this_machine_is_answered(host: str, tmp_path: Path):
    with serving(tmp_path) as server:
        status, body, headers = asked(server, [("Host", host)])
    assert (status, body) == (200, b"who was where")
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert "Access-Control-Allow-Origin" not in headers


FOREIGN = [
    "evil.example:PORT",
    "evil.example",
    "127.0.0.1.evil.example:PORT",
    "localhost.evil.example",
    "10.1.2.3:PORT",
]
FOREIGN += [
    "evil@localhost:PORT",
    "localhost:PORT/x",
    "[::1",
    "",
    "localhost evil.example",
    socket.gethostname() + ".evil",
]


@pytest.mark.parametrize("path", [RECORDING, "/", "/?url=x"])
@pytest.mark.parametrize("host", FOREIGN)
def test_who_names_another_machine_gets_nothing(host: str, path: str, tmp_path: Path):
    with serving(tmp_path) as server:
        status, body, headers = asked(server, [("Host", host)], path)
    assert status == 421
    assert b"who was where" not in body
    assert "Location" not in headers


def test_no_host_or_two_get_nothing(tmp_path: Path):
    with serving(tmp_path) as server:
        assert asked(server, [])[0] == 421
        assert asked(server, [("Host", "localhost:PORT"), ("Host", "evil.example")])[0] == 421


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://localhost:1", "https://localhost:PORT"])
def test_a_page_of_another_origin_gets_nothing(origin: str, tmp_path: Path):
    with serving(tmp_path) as server:
        status, body, _ = asked(server, [("Host", "localhost:PORT"), ("Origin", origin)])
        assert asked(server, [("Host", "localhost:PORT"), ("Origin", "http://localhost:PORT")])[0] == 200
    assert status == 403
    assert b"who was where" not in body


def test_bound_everywhere_the_address_that_was_called_and_the_machines_name_will_do(tmp_path: Path):
    with serving(tmp_path, "0.0.0.0") as server:
        assert asked(server, [("Host", "127.0.0.2:PORT")], to="127.0.0.2")[0] == 200
        assert asked(server, [("Host", f"{socket.gethostname()}:PORT")])[0] == 200
        assert asked(server, [("Host", "10.1.2.3:PORT")])[0] == 421
        assert asked(server, [("Host", "evil.example:PORT")])[0] == 421


def test_the_page_is_sent_to_the_recording_at_the_name_that_was_asked(tmp_path: Path):
    with serving(tmp_path) as server:
        status, _, headers = asked(server, [("Host", "localhost:PORT")], "/")
        assert status == 302
        assert f"localhost%3A{server.server_address[1]}%2Freplay.rrd" in headers["Location"]


def test_no_name_of_the_address_is_asked_for_in_the_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(socket, "getfqdn", lambda *_: pytest.fail("a name was looked up"))
    with serving(tmp_path) as server:
        assert server.address == f"http://127.0.0.1:{server.server_address[1]}/"


@pytest.mark.parametrize("bind", ["a" * 300, "..", "x..y"])
def test_an_address_that_is_none_is_said(bind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "_viewer_files", dict)
    (tmp_path / "x.rrd").write_bytes(b"x")
    with pytest.raises(CyclekitError, match="cannot serve the replay at"):
        serve(tmp_path / "x.rrd", bind=bind, port=0)
