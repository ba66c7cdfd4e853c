"""Keys that would stop a process, or hold back what it says, leave no motor running: on the host's own terminal."""

from __future__ import annotations

import asyncio
import os
import pty
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest
from boards import rows_of, until
from lines import BRAKE, PtyBoard
from places import PACKAGES
from test_safe_stops import LIMIT_S, STEP_40, Host, own_terminal, whole
from tornado.websocket import websocket_connect


@pytest.fixture
def board() -> Iterator[PtyBoard]:
    with PtyBoard() as made:
        yield made


@pytest.fixture(autouse=True)
def _checkout(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PYTHONPATH", str(PACKAGES))
    (tmp_path / "step_40.toml").write_text(STEP_40)


@pytest.mark.parametrize("command", [["manual", "--pwm", "40"], ["run", "step_40.toml", "--log", "run.csv"]])
@pytest.mark.parametrize(("key", "code"), [(b"\x1a", 148), (b"\x1c", 131)])
def test_keys_that_stop_a_process_brake(
    board: PtyBoard, tmp_path: Path, command: list[str], key: bytes, code: int
) -> None:
    """Ctrl-Z would leave the motor running and drive on at fg, Ctrl-\\ would end the host without a brake."""
    terminal, end = pty.openpty()
    if command[0] == "manual":
        command = [*command, "--log", "run.csv"]
    host = Host(board, tmp_path, *command, preexec_fn=own_terminal(end), stdout=end)  # no keys: it asks for none
    os.close(end)
    host.drives()
    os.write(terminal, key)
    assert host.ended() == code
    whole(host.log, "stopped by Ctrl-")
    os.close(terminal)


def test_ctrl_s_holds_nothing_up(board: PtyBoard, tmp_path: Path) -> None:
    """Held output would hold the loop: it goes on, and Ctrl-C is heard."""
    terminal, end = pty.openpty()
    before = termios.tcgetattr(end)
    command = ["run", "step_40.toml", "--log", "run.csv"]
    host = Host(board, tmp_path, *command, preexec_fn=own_terminal(end), stdout=end)
    host.drives()
    os.write(terminal, b"\x13")
    host.drives(len(rows_of(host.log)) + 500)  # longer than from one shown line to the next
    os.write(terminal, b"\x03")
    assert host.ended() == 130
    whole(host.log, "stopped by Ctrl-C")
    assert termios.tcgetattr(end) == before
    os.close(end)
    os.close(terminal)


@pytest.mark.parametrize(
    "command",
    [
        ["deadband", "--plot", "d.png"],
        ["close-loop", "--report", "circle"],
        ["watch", "--experiment", "step_40.toml", "--log", "run.csv"],
        ["lab", "manual", "--report", "lab"],
        ["doctor", "--move"],
    ],
)
def test_ctrl_z_brakes_in_whatever_drives(board: PtyBoard, tmp_path: Path, command: list[str]) -> None:
    """And at fg there is nothing left that could drive on: the command has ended."""
    terminal, end = pty.openpty()
    host = Host(board, tmp_path, *command, preexec_fn=own_terminal(end), stdin=end, stdout=end)
    os.close(end)

    def is_driven() -> bool:
        assert host.process.poll() is None, host.said
        return any(sent.compare for sent in list(board.commands))

    until(is_driven)
    stopped_by_a_key(host, terminal)


def test_ctrl_z_brakes_in_the_panel_too(board: PtyBoard, tmp_path: Path) -> None:
    terminal, end = pty.openpty()
    host = Host(board, tmp_path, "panel", "--web", "--port", "0", "--away", "20", preexec_fn=own_terminal(end),
                stdin=end, stdout=end)  # fmt: skip
    os.close(end)
    shown = ""
    while "; " not in shown.partition("panel at ")[2]:
        shown += os.read(terminal, 1000).decode()
    where = shown.partition("panel at http")[2].partition("; ")[0]

    async def drive() -> None:
        browser = await websocket_connect("ws" + where.replace("/?", "/socket?"))
        while not any(sent.compare for sent in list(board.commands)):
            await browser.write_message('{"type": "act", "name": "duty", "value": 60}')
            await asyncio.sleep(0.05)
        stopped_by_a_key(host, terminal)

    asyncio.run(drive())


def stopped_by_a_key(host: Host, terminal: int) -> None:
    """Press Ctrl-Z: the host ends, and after its last command to drive there are brakes alone."""
    os.write(terminal, b"\x1a")
    assert host.process.wait(LIMIT_S) == 148, host.said
    host.board.takes_all()
    sent = [tuple(one) for one in host.board.commands]
    last = max(k for k, one in enumerate(sent) if one[0])
    assert len(sent) > last + 2
    assert set(sent[last + 1 :]) == {BRAKE}
    assert "Ctrl-Z (SIGTSTP)" in host.said
    assert "Traceback" not in host.said
    os.close(terminal)
