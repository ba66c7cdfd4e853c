"""``fiohost panel``: what a person may ask of it, and that the motor is braked whatever becomes of it."""

from __future__ import annotations

import json
import math
import multiprocessing
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from boards import WatchedTransport, bench_on
from places import PACKAGES
from test_cli_drive import refused

from fiohost.bench.log import Log
from fiohost.errors import FiohostError, LimitError
from fiohost.panel import link
from fiohost.panel.controls import Controls
from fiohost.panel.link import PanelProgram
from fiohost.panel.web import checked
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(PACKAGES))


# ---- what may be asked ---------------------------------------------------------------------------------------------


def test_duty_is_bounded_by_the_limit_of_the_target_and_zero_brakes() -> None:
    controls = Controls(limit_pct=60.0)
    assert controls.command == BRAKE_COMMAND
    for asked, got in ((40, 40.0), (99.0, 60.0), (-1e5, -60.0), (0, 0.0)):
        controls.act("duty", asked)
        assert controls.command.duty_pct == got
    assert controls.command == BRAKE_COMMAND
    controls.act("change", 500.0)
    controls.act("reverse")
    assert (controls.command.duty_pct, controls.command.c3, controls.command.c4) == (-60.0, 0, 1)
    controls.act("standby")
    assert controls.command == STANDBY_COMMAND


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "40", None, True, [40], 10**400, {}])
def test_what_is_no_finite_number_is_refused_and_changes_nothing(value: object) -> None:
    controls = Controls()
    controls.act("duty", 30)
    for name in ("duty", "change"):
        with pytest.raises(LimitError, match="finite number"):
            controls.act(name, value)
    with pytest.raises(LimitError, match="did you mean 'standby'"):
        controls.act("stanby")
    assert controls.command.duty_pct == 30.0


def test_after_an_emergency_stop_only_its_release_is_obeyed_and_that_brakes() -> None:
    controls = Controls()
    controls.act("duty", 80)
    controls.act("emergency")
    for name, value in (("duty", 50.0), ("change", 5.0), ("standby", None), ("reverse", None), ("brake", None)):
        controls.act(name, value)
        assert (controls.command, controls.stopped) == (BRAKE_COMMAND, True)
    controls.act("release")
    assert (controls.command, controls.stopped) == (BRAKE_COMMAND, False)
    controls.act("duty", 50.0)
    assert controls.command.duty_pct == 50.0


@pytest.mark.parametrize(
    "message",
    ["", "[]", "7", '{"type": []}', '{"type": "eval"}', '{"type": "act", "name": "_drive", "value": 5}', "[" * 9999,
     '{"type": "act", "name": "duty", "value": NaN}', '{"type": "act", "name": "duty", "value": "1"}',
     '{"type": "act", "name": "duty", "value": 1e9}', '{"type": "act", "name": "record", "value": "x.csv"}',
     '{"type": "act", "name": "source", "value": {"shape": "sine", "amplitude": 5, "period_s": 1, "more": 1}}',
     '{"type": "act", "name": "loop", "value": {"kp": Infinity}}', '{"type": "act", "name": "loop", "value": 7}'],
)  # fmt: skip
def test_of_what_a_browser_sends_only_bounded_actions_are_taken(message: str) -> None:
    assert checked(message) is None
    asked = {"type": "act", "name": "source", "value": {"shape": "sine", "amplitude": 5, "offset": 1, "period_s": 2}}
    assert checked(json.dumps({**asked, "more": 1})) == asked
    assert checked('{"type": "act", "name": "brake", "value": {"x": 1}}') == {
        "type": "act", "name": "brake", "value": None,
    }  # fmt: skip


def test_sources_drive_within_the_limit_and_a_hand_takes_over() -> None:
    controls = Controls(limit_pct=50.0)
    controls.act("source", {"shape": "square", "amplitude": 30.0, "offset": 10.0, "period_s": 2.0})
    assert controls.drives
    duties = [controls.answer(7.0 + t, 0.0)[0].duty_pct for t in (0.0, 0.9, 1.1, 1.9, 2.1)]
    assert duties == [40.0, 40.0, -20.0, -20.0, 40.0]
    controls.act("source", {"shape": "sine", "amplitude": 20.0, "offset": 0.0, "period_s": 4.0})
    duties = [controls.answer(20.0 + t, 0.0)[0].duty_pct for t in (0.0, 1.0, 2.0, 3.0)]
    assert duties == pytest.approx([0.0, 20.0, 0.0, -20.0], abs=1e-9)
    controls.act("source", {"shape": "step", "amplitude": -15.0, "offset": 5.0, "period_s": 2.0})
    assert [controls.answer(30.0 + t, 0.0)[0].duty_pct for t in (0.0, 0.9, 1.0)] == [5.0, 5.0, -10.0]
    controls.act("duty", 12.0)
    assert (controls.doing, controls.answer(40.0, 0.0)[0].duty_pct) == ("hand", 12.0)
    for bad in ({"shape": "saw"}, {"shape": "sine", "amplitude": 40.0, "offset": 20.0}, {"period_s": 0.0}, 5, None):
        with pytest.raises(LimitError):
            controls.act("source", bad)
    controls.act("emergency")
    controls.act("source", {"shape": "hold", "offset": 20.0})
    assert controls.answer(50.0, 0.0)[0] == BRAKE_COMMAND


@pytest.mark.parametrize("kind", ["p", "pd", "pi", "pid"])
def test_a_controller_reaches_its_set_point_and_its_gains_change_while_it_runs(kind: str) -> None:
    controls = Controls()
    angle, speed = 0.0, 0.0
    gains = {"kp": 1.0, "ki": 2.0, "kd": 0.04}
    controls.act("loop", {"kind": kind, **gains, "shape": "hold", "offset": 90.0})
    duty = 0.0
    for k in range(1600):  # a motor of 10 deg/s per percent and 80 ms that has to hold 5 % against a weight
        command, ref = controls.answer(0.005 * k, angle)
        duty = command.duty_pct
        assert ref == 90.0
        if k == 800:
            controls.act("loop", {"kind": kind, **gains, "kp": 2.0, "shape": "hold", "offset": 90.0})
        speed += 0.005 / 0.08 * (10.0 * (duty - 5.0) - speed)
        angle += 0.005 * speed
        if k == 799:
            first = abs(90.0 - angle)
    if "i" in kind:
        assert abs(90.0 - angle) < 0.5
        assert duty == pytest.approx(5.0, abs=1.0)
    else:  # a load bends a controller without an integral by load over kp
        assert first == pytest.approx(5.0, abs=0.5)
        assert abs(90.0 - angle) == pytest.approx(2.5, abs=0.3)
    with pytest.raises(LimitError, match="did you mean 'pid'"):
        controls.act("loop", {"kind": "pidd"})


# ---- the bench's side of the link ----------------------------------------------------------------------------------


class Script:
    """A display that sends given messages at given ticks, and keeps what it is answered."""

    def __init__(self, messages: dict[int, bytes | type[Exception]]) -> None:
        self.answers: list[Any] = []
        self._messages, self._tick = messages, -1

    def poll(self) -> bool:
        self._tick += 1
        return self._tick in self._messages

    def recv_bytes(self, most: int) -> bytes:
        message = self._messages[self._tick]
        if isinstance(message, bytes):
            return message
        raise message

    def send_bytes(self, answer: bytes) -> None:
        self.answers.append(json.loads(answer))


def play(messages: dict[int, Any], **limits: float) -> tuple[WatchedTransport, Script, Callable[[], int]]:
    transport, script = WatchedTransport(), Script(messages)
    bench = bench_on(transport, **limits)
    program = PanelProgram(bench, script, "the panel died")  # type: ignore[arg-type]

    def run() -> int:
        try:
            return bench.live(program, "run.csv", None, program, link.READING_S, program.recorder.row)
        finally:
            program.recorder.close()

    return transport, script, run


def act(name: str, value: Any = None) -> bytes:
    return json.dumps({"act": name, "value": value}).encode()


def test_the_bench_answers_frames_obeys_and_ends_when_the_display_is_closed() -> None:
    frame = b'{"frame": true}'
    transport, script, run = play({2: act("duty", 40.0), 200: act("duty", math.nan), 210: frame, 400: frame,
                                   410: b'{"closed": true}'})  # fmt: skip
    rows = run()
    assert transport.braked
    log = Log.read("run.csv")
    assert len(log) == rows
    assert log.metadata["ending"] == "complete"
    first, second = script.answers
    assert (first["mode"], first["duty_pct"], first["handled"]) == ("drive", 40.0, 2)
    assert "finite number" in first["note"]
    times = [row[0] for row in first["readings"] + second["readings"]]
    assert times == sorted(set(times))  # each reading once
    assert second["readings"][-1][4] == int(log.columns["pos"][round(times[-1] / 0.005)])


def test_the_record_button_makes_a_log_of_its_own_that_can_be_fitted() -> None:
    frame = b'{"frame": true}'
    loop = {"kind": "pd", "kp": 1.0, "kd": 0.03, "shape": "square", "offset": 90, "amplitude": 45, "period_s": 2}
    _, script, run = play({2: act("loop", loop), 100: act("record", True), 300: frame, 700: act("record", False),
                           710: frame, 800: b'{"closed": true}'})  # fmt: skip
    run()
    (path,) = Path.cwd().glob("panel-*.csv")
    log = Log.read(path)
    assert 590 <= len(log) <= 600  # a message is heard in the tick of the one before it
    assert log.time_s[0] == 0.0
    assert log.metadata["ending"] == "complete"
    assert set(log.columns["ref_deg"]) == {45.0, 135.0}
    whole = Log.read("run.csv")
    assert len(whole) > len(log)
    rows = list(whole.columns["pos"]), list(log.columns["pos"])
    assert any(rows[0][start : start + len(log)] == rows[1] for start in range(90, 110)), "every tick, in order"
    during, after = script.answers
    assert (during["recording"], during["doing"]) == (path.name, "loop")
    assert 150 < during["recorded"] < 250
    assert after["recording"] == ""
    assert f"{len(log)} rows" in after["note"]


def test_the_limits_of_the_target_hold_for_a_person_too() -> None:
    _, _, run = play({2: act("duty", 90.0), 400: b'{"closed": true}'}, duty_pct=30.0, slew_pct_per_s=100.0)
    run()
    log = Log.read("run.csv")
    assert max(log.duty_pct) == 30.0
    assert np.diff(log.duty_pct).max() <= 0.5 + 1e-4
    for limit in ({"travel_deg": 90.0}, {"run_time_s": 0.5}):
        Path("run.csv").unlink()
        transport, _, run = play({2: act("duty", 70.0)}, **limit)
        with pytest.raises(LimitError, match="limit of"):
            run()
        assert transport.braked


@pytest.mark.parametrize(
    "last", [EOFError, OSError, b"no json", b"[1]", b'{"frame": 1}', b'{"act": 5}', b'{"closed": true, "x": '],
)  # fmt: skip
def test_a_display_that_dies_or_raves_is_braked_for_and_the_log_is_whole(last: Any) -> None:
    transport, _, run = play({2: act("duty", 70.0), 100: last})
    with pytest.raises(FiohostError, match="the panel died"):
        run()
    assert transport.braked
    log = Log.read("run.csv")
    assert log.duty_pct[-1] == 70.0
    assert "the panel died" in log.metadata["ending"]


def test_a_display_that_hangs_is_braked_for_and_may_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter(i * 0.005 for i in range(10_000))
    monkeypatch.setattr(link.time, "monotonic", lambda: next(now))
    _, script, run = play({2: act("duty", 70.0), 600: b'{"frame": true}', 700: act("duty", 20.0),
                           800: b'{"closed": true}'})  # fmt: skip
    run()
    log = Log.read("run.csv")
    braked = [k for k in range(1, len(log)) if log.duty_pct[k] == 0.0 and log.duty_pct[k - 1] != 0.0]
    assert len(braked) == 1
    assert braked[0] * 0.005 == pytest.approx(link.HANG_S, abs=0.05)
    assert "did not answer" in script.answers[0]["note"]
    assert log.duty_pct[-1] == 20.0


def test_a_display_that_was_closed_stays_until_the_bench_has_heard_it() -> None:
    bench, display = multiprocessing.Pipe()

    def leave() -> None:
        link.Remote(display).closed()
        display.close()

    bench.send_bytes(b"an answer that nobody waits for any more")
    leaving = threading.Thread(target=leave)
    leaving.start()
    leaving.join(0.3)
    assert leaving.is_alive()
    assert json.loads(bench.recv_bytes()) == {"closed": True}
    bench.close()
    leaving.join(2.0)
    assert not leaving.is_alive()


def test_what_makes_no_sense_is_refused_before_anything_is_opened() -> None:
    for arguments, reason in (
        (["--port", "80"], "add --web"),
        (["--web", "--port", "99999"], "--port"),
        (["--web", "--away", "nan"], "--away"),
        (["--target", "nowhere"], "unknown target"),
    ):
        assert reason in refused("panel", *arguments)
