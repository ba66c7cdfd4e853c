"""Traces and replays, event by event."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fiohost.errors import ConfigError, DisconnectedError, LogError, TelemetryTimeoutError
from fiohost.transport import replay
from fiohost.transport.profile import TargetProfile
from fiohost.transport.replay import ReplayTransport
from fiohost.transport.trace import MAX_LINE_BYTES, Event, TraceReader, TraceWriter

HEAD = {
    "schema": "fiohost.trace/1", "profile": "hid-assumed", "profile_toml": TargetProfile.load().text,
    "lock_step": True, "stream": False,
}  # fmt: skip


def trace_of(path: Path, *events: Any, **head: Any) -> Path:
    """A file with that head and those lines (text as it is, else JSON)."""
    lines = [json.dumps({**HEAD, **head}), *(e if isinstance(e, str) else json.dumps(e) for e in events)]
    path.write_text("\n".join(lines) + "\n")
    return path


# ---- reading -------------------------------------------------------------------------------------------------------


def test_events_are_read_with_their_time_bytes_and_count(tmp_path: Path) -> None:
    path = trace_of(
        tmp_path / "t.jsonl", {"t": 1, "dir": "in", "hex": "00 ff", "passed_over": 4294967295},
        {"t": -1e12, "dir": "none"}, HEAD, {"t": 1e12, "dir": "gone"}, {"t": 0.5, "dir": "out", "hex": "7e"},
    )  # fmt: skip
    assert list(TraceReader(path).events()) == [
        Event(1.0, "in", b"\x00\xff", 4294967295), Event(-1e12, "none"), Event(1e12, "gone"), Event(0.5, "out", b"~"),
    ]  # fmt: skip
    assert Event(0.0, "in") == Event(0.0, "in", b"", 0)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ({"t": 1.0000001e12, "dir": "in"}, "is not an event: dir is one of out, in, none, gone"),
        ({"t": 0, "dir": "in", "passed_over": 4294967296}, "is not an event: dir"),
        ({"t": 0, "dir": "in", "passed_over": -1}, "is not an event: dir"),
        ({"t": 0, "dir": "up"}, "is not an event: dir"),
        ({"dir": "in"}, "is not an event with t, dir and hex .KeyError"),
        ({"t": 0, "dir": "in", "hex": "0g"}, "is not an event with t, dir and hex .ValueError"),
        ("[]", "is not a JSON object"),
        ("{", "is not a JSON object"),
        ({"schema": "fiohost.trace/1", "profile_toml": "other"}, "begins a session with another target profile"),
        (" " * (MAX_LINE_BYTES + 2), "is longer than 100000 bytes"),
    ],
)
def test_a_line_that_is_no_event_is_told_by_its_number(line: Any, said: str, tmp_path: Path) -> None:
    path = trace_of(tmp_path / "t.jsonl", {"t": 0, "dir": "none"}, line)
    with pytest.raises(ConfigError, match=f"t.jsonl line 3 {said}"):
        list(TraceReader(path).events())


def test_a_line_may_be_as_long_as_is_said_and_the_last_may_be_cut_off(tmp_path: Path) -> None:
    event = json.dumps({"t": 0, "dir": "none"})
    longest = event + " " * (100_000 - len(event))
    path = trace_of(tmp_path / "t.jsonl", longest)
    assert list(TraceReader(path).events()) == [Event(0.0, "none")]
    with path.open("a") as file:
        file.write(longest)
    assert len(list(TraceReader(path).events())) == 1
    with pytest.raises(ConfigError, match="is longer than 100000"):
        list(TraceReader(trace_of(path, longest + " ")).events())
    for text in ("", "[]\n", '{"schema": "fiohost.trace/2"}\n'):
        path.write_text(text)
        with pytest.raises(ConfigError, match="is not a trace: its first line"):
            TraceReader(path)


# ---- writing -------------------------------------------------------------------------------------------------------


def test_a_trace_is_written_with_microseconds_since_its_session_began(tmp_path: Path) -> None:
    writer = TraceWriter(tmp_path / "t.jsonl")
    writer.session({"lock_step": True, "name": "ä"}, 100.0)
    writer.event(100.12345678, "in", b"\x01\x02", 3)
    writer.event(100.25, "none")
    writer.session({"lock_step": True}, 200.0)
    writer.event(200.5, "out", b"\x03")
    writer.close()
    writer.event(300.0, "in")  # nobody hears it
    lines = (tmp_path / "t.jsonl").read_text().splitlines()
    assert lines == [
        '{"schema": "fiohost.trace/1", "lock_step": true, "name": "ä"}',
        '{"t": 0.123457, "dir": "in", "hex": "01 02", "passed_over": 3}', '{"t": 0.25, "dir": "none"}',
        '{"schema": "fiohost.trace/1", "lock_step": true}', '{"t": 0.5, "dir": "out", "hex": "03"}',
    ]  # fmt: skip
    TraceWriter(tmp_path / "none.jsonl").close()


class Behind:
    """What writes behind the loop, as a test has it."""

    def __init__(self, *, takes: bool = True, ends: bool = True, problem: Exception | None = None) -> None:
        self.waiting, self.problem, self._takes, self._ends = 5, problem, takes, ends
        self.put_in: list[bytes] = []

    def put(self, line: bytes) -> bool:
        self.put_in.append(line)
        return self._takes

    def close(self, limit_s: float) -> bool:
        assert limit_s == 5.0
        return self._ends


def test_a_disk_that_fails_under_a_trace_is_said_once_and_the_brake_goes_out(tmp_path: Path) -> None:
    def behind(**how: Any) -> Any:
        made: Any = TraceWriter(tmp_path / f"{len(list(tmp_path.iterdir()))}.jsonl")
        made.session({}, 0.0)
        made._behind.close(100.0)
        made._behind = Behind(**how)
        return made

    writer = behind(takes=False)
    with pytest.raises(LogError, match=r"cannot write the trace .*: the disk takes nothing"):
        writer.event(0.0, "in")
    writer.event(0.0, "out")
    assert len(writer._behind.put_in) == 1
    writer = behind(problem=LogError("full"))
    with pytest.raises(LogError, match="full"):
        writer.event(0.0, "in")
    writer.event(0.0, "out")
    writer.close()  # it was said
    writer = behind(problem=LogError("full"))
    with pytest.raises(LogError, match="full"):
        writer.close()
    with pytest.raises(LogError, match="does not answer: 5 lines are lost"):
        behind(ends=False).close()


# ---- replays -------------------------------------------------------------------------------------------------------


def test_a_replay_gives_what_came_in_its_order_and_ends_once(tmp_path: Path) -> None:
    path = trace_of(
        tmp_path / "t.jsonl", {"t": 0.25, "dir": "out", "hex": "09"},
        {"t": 0.5, "dir": "in", "hex": "01", "passed_over": 2}, {"t": 0.75, "dir": "none"},
        {"t": 1.0, "dir": "in", "hex": "02", "passed_over": 3}, {"t": 1.25, "dir": "gone"}, {"t": 1.5, "dir": "none"},
        identity="x" * 300, target="y" * 300, counts_per_rev=4, facts={"plant": "p", "n": 1},
    )  # fmt: skip
    made = ReplayTransport(path)
    assert (made.time_s, made.name, made.identity) == (0.0, f"replay:{path}", "x" * 200)
    assert (made.lock_step, made.stream, made.counts_per_rev) == (True, False, 4)
    assert made.facts == {"plant": "p", "n": "1", "replay_of": "y" * 200}
    with pytest.raises(DisconnectedError, match="the trace is closed"):
        made.send(b"")
    made.open()
    assert (made.receive(0.0), made.time_s, made.passed_over) == (b"\x01", 0.5, 2)
    with pytest.raises(TelemetryTimeoutError, match="nothing came in this tick"):
        made.receive(0.0)
    assert (made.receive(0.0), made.passed_over) == (b"\x02", 5)
    with pytest.raises(DisconnectedError, match="ends here"):
        made.receive(0.0)
    with pytest.raises(TelemetryTimeoutError):
        made.receive(0.0)
    with pytest.raises(TelemetryTimeoutError, match="the trace has ended"):
        made.receive(0.0)
    made.close()
    made.open()
    assert made.receive(0.0) == b"\x01"


@pytest.mark.parametrize(("counts", "found"), [(3, None), (1 << 24, 1 << 24), ((1 << 24) + 1, None), ("720", None)])
def test_a_replay_believes_counts_that_can_be(counts: Any, found: int | None, tmp_path: Path) -> None:
    made = ReplayTransport(trace_of(tmp_path / "t.jsonl", counts_per_rev=counts, facts=3, lock_step=1, stream="yes"))
    assert (made.counts_per_rev, made.facts) == (found, {"replay_of": ""})
    assert (made.lock_step, made.stream) == (False, False)
    for missing in ("profile", "profile_toml"):
        with pytest.raises(ConfigError, match="has no profile and profile_toml"):
            ReplayTransport(trace_of(tmp_path / "t.jsonl", **{missing: None}))


def test_a_replay_is_paced_where_that_is_asked_and_never_by_more_than_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept: list[float] = []
    now_s = [1000.0]
    monkeypatch.setattr(replay, "time", SimpleNamespace(monotonic=lambda: now_s[0], sleep=slept.append))
    path = trace_of(tmp_path / "t.jsonl", *({"t": t, "dir": "in", "hex": "01"} for t in (0.25, 0.5, 9.0)))
    made = ReplayTransport(path, paced=True)
    made.open()
    for t in (1000.0, 1000.75, 1000.75):
        now_s[0] = t
        made.receive(0.0)
    assert slept == [0.25, 0.0, 1.0]
    plain = ReplayTransport(path)
    plain.open()
    plain.receive(0.0)
    assert len(slept) == 3
