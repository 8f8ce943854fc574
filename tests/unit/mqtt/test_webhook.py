"""A webhook at a real web server, which refuses, stalls, goes away and comes back."""

import ssl
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs
from support.processes import find_free_port
from support.waiting import wait_until
from support.web import WebServer, with_status

from trolley.config import ConfigError, FootprintConfig, RobotConfig, RobotSection, WebhookConfig
from trolley_mqtt.events import Happened
from trolley_mqtt.webhook import (
    Endpoint,
    Report,
    Webhook,
    WebhookParams,
    endpoints_of,
    notification,
)

QUICK = WebhookParams(
    time_limit_s=60.0, first_pause_s=0.01, longest_pause_s=0.05, max_waiting=3, goodbye_s=60.0
)
EVENT = Happened(event_type="arrived", message="The robot has arrived.", place="kitchen")
SECRET = "s3cret"


class Sender:
    """A webhook, and what it reports."""

    def __init__(self, url: str, params: WebhookParams, **endpoint: Any) -> None:
        self.reports: list[Report] = []
        self.webhook = Webhook(Endpoint(url=url, **endpoint), self.reports.append, params)
        self.webhook.start()
        self._num = 0

    def send(self, count: int = 1) -> None:
        for _ in range(count):
            self._num += 1
            self.webhook.send(notification(EVENT, str(self._num), None, "robby", "Robby"))

    @property
    def num_sent(self) -> int:
        return sum(one.num_sent for one in self.reports)

    @property
    def num_dropped(self) -> int:
        return sum(one.num_dropped for one in self.reports)

    @property
    def problems(self) -> list[str]:
        return [one.problem for one in self.reports if one.problem]

    def wait_for_problem(self, words: str) -> None:
        wait_until(lambda: any(words in one for one in self.problems), f"{words}: {self.reports}")


@pytest.fixture
def make_server() -> Iterator[Callable[..., WebServer]]:
    opened: list[WebServer] = []

    def make(*answers: Any, port: int = 0) -> WebServer:
        opened.append(WebServer(*answers, port=port))
        return opened[-1]

    yield make
    for server in opened:
        server.close()


@pytest.fixture
def make_sender() -> Iterator[Callable[..., Sender]]:
    opened: list[Sender] = []

    def make(url: str, params: WebhookParams = QUICK, **endpoint: Any) -> Sender:
        opened.append(Sender(url, params, **endpoint))
        return opened[-1]

    yield make
    for sender in opened:
        sender.webhook.close()
        assert not any(SECRET in one for one in sender.problems)


MakeServer = Callable[..., WebServer]
MakeSender = Callable[..., Sender]


def test_the_body_says_everything_once(make_server: MakeServer, make_sender: MakeSender) -> None:
    server = make_server()
    make_sender(server.url, token="t0ken").send()
    wait_until(lambda: server.taken, "it arrives")
    assert server.taken == [
        {
            "version": 1,
            "id": "1",
            "at": None,
            "robot": "robby",
            "title": "Robby",
            "event_type": "arrived",
            "message": "The robot has arrived.",
            "reason": "",
            "place": "kitchen",
            "tour": None,
        }
    ]
    assert server.headers[0]["Authorization"] == "Bearer t0ken"
    assert server.headers[0]["Content-Type"] == "application/json"
    assert server.paths == [f"/hook/{SECRET}?key={SECRET}"]


@pytest.mark.parametrize("status", [400, 401, 404, 410])
def test_what_is_refused_for_good_is_not_sent_again(
    status: int, make_server: MakeServer, make_sender: MakeSender
) -> None:
    server = make_server(with_status(status), with_status(204))
    sender = make_sender(server.url)
    sender.send(2)
    wait_until(lambda: sender.num_sent == 1, "the second is taken")
    assert [one["id"] for one in server.taken] == ["1", "2"]
    assert sender.num_dropped == 1
    assert f"refuses what is sent to it: it answers {status}" in sender.problems[0]


@pytest.mark.parametrize("status", [429, 500, 503])
def test_what_may_be_taken_later_is_sent_again_in_order(
    status: int, make_server: MakeServer, make_sender: MakeSender
) -> None:
    server = make_server(with_status(status), with_status(status), with_status(200))
    sender = make_sender(server.url)
    sender.send(2)
    wait_until(lambda: sender.num_sent == 2, "both are taken")
    assert [one["id"] for one in server.taken] == ["1", "1", "1", "2"]
    assert "cannot take anything at the moment" in sender.problems[0]
    assert sender.num_dropped == 0


def test_a_redirect_is_not_followed(make_server: MakeServer, make_sender: MakeSender) -> None:
    elsewhere = make_server()
    away = f"http://me:{SECRET}@127.0.0.1:{elsewhere.port}/{SECRET}"
    server = make_server(with_status(307, Location=away))
    sender = make_sender(server.url, token=SECRET)
    sender.send()
    sender.wait_for_problem(f"redirects to 127.0.0.1:{elsewhere.port}: write the new address")
    assert elsewhere.taken == []


def test_a_server_that_is_down_gets_it_once_it_is_back(
    make_server: MakeServer, make_sender: MakeSender
) -> None:
    port = find_free_port()
    sender = make_sender(f"http://127.0.0.1:{port}/{SECRET}")
    sender.send()
    sender.wait_for_problem(f"127.0.0.1:{port} does not answer: nothing listens there")
    server = make_server(port=port)
    wait_until(lambda: sender.num_sent == 1, "it is taken")
    assert len(server.taken) == 1
    assert sender.reports[-1] == Report(num_sent=1)


@pytest.mark.parametrize("slowly", ["hang", "drip"])
def test_a_slow_server_is_cut_off_and_asked_again(
    slowly: str, make_server: MakeServer, make_sender: MakeSender
) -> None:
    server = make_server()
    server.answers = [getattr(server, slowly), with_status(204)]
    sender = make_sender(server.url, structs.replace(QUICK, time_limit_s=0.3))
    sender.send()
    wait_until(lambda: sender.num_sent == 1, "it is taken at last")
    assert "did not answer within 0.3 s" in sender.problems[0]
    assert len(server.taken) >= 2


def test_whoever_is_no_web_server_is_told_of(
    make_server: MakeServer, make_sender: MakeSender
) -> None:
    server = make_server()
    server.answers = [server.garble, with_status(204)]
    sender = make_sender(server.url)
    sender.send()
    wait_until(lambda: sender.num_sent == 1, "it is taken at last")
    assert "does not answer as a web server does" in sender.problems[0]
    encrypted = make_sender(server.url.replace("http:", "https:"))
    encrypted.send()
    encrypted.wait_for_problem("is it http:// instead of https://?")


def test_too_many_push_out_the_oldest(make_server: MakeServer, make_sender: MakeSender) -> None:
    server = make_server()
    server.answers = [server.hang, with_status(204)]
    sender = make_sender(server.url)
    sender.send()
    wait_until(lambda: server.taken, "the first is on its way")
    sender.send(10)  # returns at once, though nobody takes anything
    assert sender.num_dropped == 7
    server.released.set()
    wait_until(lambda: sender.num_sent == 4, "the first and the newest are taken")
    assert [one["id"] for one in server.taken][-3:] == ["9", "10", "11"]


def test_old_news_are_dropped(make_server: MakeServer, make_sender: MakeSender) -> None:
    server = make_server(with_status(503))
    sender = make_sender(server.url, structs.replace(QUICK, keep_s=0.0))
    sender.send()
    wait_until(lambda: sender.num_dropped == 1, "it is dropped")
    assert len(server.taken) == 1


def test_closing_does_not_wait_for_a_server_that_hangs(make_server: MakeServer) -> None:
    server = make_server()
    server.answers = [server.hang]
    slow = structs.replace(QUICK, goodbye_s=0.0)
    sender = Sender(server.url, slow)
    sender.send(2)
    wait_until(lambda: server.taken, "the first is on its way")
    sender.webhook.close()
    assert not server.released.is_set()
    assert len(server.taken) == 1


@pytest.mark.parametrize(
    "url",
    [
        "",
        "house",
        "ftp://house/x",
        "http://",
        "http://a b/",
        "http://h:0/",
        "http://h:99999/",
        "http://häuser/",
        "http://[::1/",
        "http://house..example/",
        f"http://{64 * 'h'}.example/",
        "http://h/\n",
        f"http://u:{SECRET}@h/",
        "http://h/" * 300,
    ],
)
def test_what_is_no_web_address_is_refused_without_repeating_it(url: str) -> None:
    why_not = r"^urls\[1\] (is not a web address|has a user name)"
    with pytest.raises(ValueError, match=why_not) as why:
        WebhookConfig(urls=["http://house.example/ok", url])
    assert SECRET not in str(why.value)


def config(folder: Path, **webhook: Any) -> RobotConfig:
    return RobotConfig(
        robot=RobotSection(name="robby", footprint=FootprintConfig(radius_m=0.2)),
        webhook=WebhookConfig(urls=["https://house/x"], **webhook),
        folder=str(folder),
    )


def test_files_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    (tmp_path / "empty").write_text("\n")
    (tmp_path / "token").write_text(f"{SECRET}\nsomething else\n")
    for settings, words in (
        ({"token_file": "nowhere"}, "token_file .*nowhere cannot be read"),
        ({"token_file": "empty"}, "token_file .*: its first line is not a token"),
        ({"tls_ca": "token"}, "tls_ca .* cannot be used"),
    ):
        with pytest.raises(ConfigError, match=words) as why:
            endpoints_of(config(tmp_path, **settings))
        assert SECRET not in str(why.value)
    (endpoint,) = endpoints_of(config(tmp_path, token_file="token"))
    assert endpoint.token == SECRET
    assert isinstance(endpoint.tls, ssl.SSLContext)
    assert SECRET not in repr(endpoint)
