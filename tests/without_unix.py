"""Run as a program: the way of a user, without modules, signals and functions that Windows lacks."""

# ruff: noqa: E402 (what is taken away is taken away first)

from __future__ import annotations

import os
import signal
import sys
from typing import Any

modules: dict[str, Any] = sys.modules
for name in ("fcntl", "termios", "tty", "pty", "pwd", "grp", "resource"):
    modules[name] = None
for name in ("SIGHUP", "SIGQUIT", "SIGTSTP", "SIGALRM", "SIGUSR1", "setitimer", "ITIMER_REAL", "pthread_sigmask"):
    if hasattr(signal, name):
        delattr(signal, name)
for name in ("O_NONBLOCK", "O_NOFOLLOW", "fchmod", "sched_setaffinity"):
    if hasattr(os, name):
        delattr(os, name)
os.environ.pop("XDG_STATE_HOME", None)
os.environ["LOCALAPPDATA"] = os.path.join(os.getcwd(), "Users", "J\u00f6rg M\u00fcller", "AppData", "Local")

from fiohost.cli.main import main


def call(*words: str) -> None:
    """One command, as typed."""
    code: Any = 0
    try:
        main(list(words))
    except SystemExit as exc:
        code = exc.code
    assert not code, words


call("run", "steps_from_rest", "--target", "sim:sealed", "--log", "run.csv")
call("unseal", "run.csv")
call("check", "run.csv")
with open("run.csv", encoding="utf-8") as file:
    rows = [line.split(",") for line in file if line[0].isdigit()]
with open("wei\u00dfes Gehäuse.csv", "w", encoding="cp1252", newline="\r\n") as file:
    file.write("Zeit [s];Stellgr\u00f6\u00dfe [%];Winkel [\u00b0]\n")
    file.writelines(";".join((r[0], r[1], r[7].strip())).replace(".", ",") + "\n" for r in rows)
call("import", "wei\u00dfes Gehäuse.csv", "--yes", "-o", "own.csv")
call("identify", "own.csv", "--from", "duty", "--save-model", "m.toml")
call("plot", "own.csv", "--against", "m.toml", "-o", "p.html")
import fiohost

with fiohost.connect("sim") as b:
    b.duty = 40
    b.sleep(0.5)
    assert b.angle_deg > 50
assert any(name == "seals" for _, folders, _ in os.walk(os.environ["LOCALAPPDATA"]) for name in folders)
