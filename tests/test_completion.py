"""The tab key in real shells: the line is typed into bash, zsh and fish on a terminal, and the shell completes it."""

from __future__ import annotations

import os
import pty
import re
import select
import shutil
import signal
import sys
import time
from pathlib import Path

import pytest
from boards import HANG_S
from places import PACKAGES

LIMIT_S = HANG_S
ESCAPES = re.compile(rb"\x1b\[[0-9;?>=]*[ -/]*[@-~]|\x1b[()=>][0-9A-B]?|\x1b\][^\x07\x1b]*(?:\x07|\x1b\\)|\r|\x08")
START = {
    "bash": ["bash", "--norc", "--noprofile", "-i"],
    "zsh": ["zsh", "-f", "-i"],
    "fish": ["fish", "--no-config", "--private", "-i"],
}
SETUP = {
    "bash": "bind 'set enable-bracketed-paste off'; PS1='$ '; eval \"$(fiohost completion bash)\"; echo READ''Y",
    "zsh": "PS1='$ '; autoload -Uz compinit; compinit -u -D; eval \"$(fiohost completion zsh)\"; echo READ''Y",
    "fish": "fiohost completion fish | source; echo READ''Y",
}
# what is typed before the tab -> what the shell makes of it
LINES = {
    "fiohost diag": "fiohost diagnose",
    "fiohost run stair": "fiohost run staircase",
    "fiohost run --target sim:nxt_no": "fiohost run --target sim:nxt_no_load",
    "fiohost manual --target serial-doc": "fiohost manual --target serial-documented",
    "fiohost effects quadratic": "fiohost effects quadratic_drag",
    "fiohost diagnose --model linear+coul": "fiohost diagnose --model linear+coulomb_friction",
}


class Terminal:
    """A shell on a terminal of its own."""

    def __init__(self, shell: str, folder: Path) -> None:
        command = folder / "fiohost"
        command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m fiohost "$@"\n')
        command.chmod(0o755)
        environment = {
            **os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "PYTHONPATH": str(PACKAGES), "HOME": str(folder),
            "TERM": "dumb" if shell != "fish" else "xterm", "XDG_STATE_HOME": str(folder / "state"),
            "XDG_CONFIG_HOME": str(folder / "config"), "XDG_DATA_HOME": str(folder / "data"), "COLUMNS": "200",
        }  # fmt: skip
        self.said = b""
        self._pid, self._fd = pty.fork()
        if self._pid == 0:
            os.chdir(folder)
            os.execvpe(START[shell][0], START[shell], environment)

    def send(self, text: str) -> None:
        os.write(self._fd, text.encode())

    def waits_for(self, wanted: str) -> bool:
        """Whether the terminal comes to show that; blanks at the ends of its lines do not count."""
        deadline = time.monotonic() + LIMIT_S
        while wanted.encode() not in ESCAPES.sub(b"", self.said):
            if time.monotonic() > deadline:
                return False
            if select.select([self._fd], [], [], 0.2)[0]:
                try:
                    self.said += os.read(self._fd, 65536)
                except OSError:
                    return False
                if b"\x1b[c" in self.said or b"\x1b[0c" in self.said:  # fish asks what the terminal is
                    self.said = self.said.replace(b"\x1b[0c", b"").replace(b"\x1b[c", b"")
                    self.send("\x1b[?62c")
        return True

    def close(self) -> None:
        os.kill(self._pid, signal.SIGKILL)
        os.waitpid(self._pid, 0)
        os.close(self._fd)


@pytest.mark.parametrize("shell", list(START))
def test_the_shell_itself_completes_commands_and_names(shell: str, tmp_path: Path) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"NO {shell} HERE: ITS TAB KEY IS NOT TESTED (apt-get install {shell})")
    terminal = Terminal(shell, tmp_path)
    try:
        terminal.send(SETUP[shell] + "\n")
        assert terminal.waits_for("READY"), terminal.said[-2000:]
        for typed, whole in LINES.items():
            terminal.said = b""
            terminal.send(typed + "\t")
            assert terminal.waits_for(whole), f"{typed!r} became {terminal.said[-500:]!r}"
            terminal.send("\x15")  # the line is wiped
    finally:
        terminal.close()
