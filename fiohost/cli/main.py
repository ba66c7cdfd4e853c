"""The ``fiohost`` command: a table of commands, each imported when it is used.

To add a command: write a click command in a module of this package and add one line to COMMANDS.
"""

from __future__ import annotations

import errno
import logging
import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NoReturn, TextIO

import click

from fiohost import __version__
from fiohost.cli.lazy import LazyCommands
from fiohost.errors import FiohostError

# Standard output has ended: its reader left, its terminal hung up, its disk is full.
OUTPUT_ENDED = (errno.EPIPE, errno.EIO, errno.ENOSPC, errno.EFBIG, errno.EBADF)

# name -> (module:attribute, short help). The help stands here so that `fiohost --help` imports no command.
COMMANDS: dict[str, tuple[str, str]] = {
    "manual": ("fiohost.cli.drive:manual", "Drive with one duty until Ctrl-C, showing angle and speed."),
    "panel": ("fiohost.cli.panel:panel", "Drive by hand with a slider, in a window or in a browser."),
    "deadband": ("fiohost.cli.deadband:deadband", "Find the duty at which the motor starts, in both directions."),
    "run": ("fiohost.cli.run:run", "Run a scripted open- or closed-loop experiment."),
    "identify": ("fiohost.cli.identify:identify", "Find K, tau, zeta and omega_n from logs."),
    "design": ("fiohost.cli.design:design", "Find gains that meet a specification on a model."),
    "diagnose": ("fiohost.cli.diagnose:diagnose", "Fit a model to logs and name what it lacks."),
    "simulate": ("fiohost.cli.diagnose:simulate", "Replay a saved model on the commands of a log."),
    "close-loop": ("fiohost.cli.circle:close_loop", "The whole circle: run, fit, find the effect, confirm."),
    "watch": ("fiohost.cli.watch:watch", "Say when a motor stops behaving like its model."),
    "lab": ("fiohost.cli.lab:lab", "The experiments of the two lab texts."),
    "convert": ("fiohost.cli.convert:convert", "Convert between units of motors and benches."),
    "tf": ("fiohost.cli.convert:tf", "A transfer function in all its forms, of a motor or any."),
    "check": ("fiohost.cli.check:check", "Say whether a log is whole, cut off or altered."),
    "import": ("fiohost.cli.imports:import_", "Make a log of any table, by what is found or by a map."),
    "plot": ("fiohost.cli.plot:plot", "Draw logs: a picture, or a page that zooms."),
    "sniff": ("fiohost.cli.sniff:sniff", "Show raw reports and the fields seen in them; drives nothing."),
    "devices": ("fiohost.cli.hardware:devices", "List boards that are connected."),
    "doctor": ("fiohost.cli.hardware:doctor", "Look for what is not right between this computer and the motor."),
    "firmware": ("fiohost.cli.firmware:firmware", "Programs for boards: list them, find them, flash them."),
    "udev": ("fiohost.cli.hardware:udev", "Print the udev rules that let you reach the boards (Linux)."),
    "export": ("fiohost.cli.export:export", "Model or controller for MATLAB, as an FMU, or in C."),
    "fleet": ("fiohost.cli.fleet:fleet", "Diagnose many benches and compare them."),
    "effects": ("fiohost.cli.data:effects", "List the effects that a model can have."),
    "plants": ("fiohost.cli.bench:plants", "List the plants of the simulated board."),
    "completion": ("fiohost.cli.completion:completion", "Set up the tab key of bash, zsh or fish."),
    "unseal": ("fiohost.cli.bench:unseal", "Show the truth about a sealed board."),
}

# How the help shows them; what is in no group comes last.
GROUPS: dict[str, tuple[str, ...]] = {
    "Bench": ("manual", "panel", "deadband", "run", "close-loop", "watch"),
    "Data": ("plot", "check", "import"),
    "Models": ("identify", "diagnose", "simulate", "design", "export", "effects", "fleet", "tf", "convert"),
    "Labs": ("lab", "plants", "unseal"),
    "Boards": ("devices", "doctor", "sniff", "firmware", "udev"),
    "This program": ("completion",),
}

START = """\
fiohost drives a DC-motor control bench, logs it, and says which effect its model lacks.

Without a board, from nothing to a result in a few minutes:
  fiohost manual --pwm 40 --duration 3                drive the simulated motor
  fiohost run square_170_190 --log run.csv            an experiment, and its log
  fiohost plot run.csv                                look at it
  fiohost identify run.csv                            gain and lag of the motor
  fiohost close-loop                                  find the effect that a sealed bench hides

With measurements of your own:
  fiohost import measured.csv                         any table becomes a log: it asks what it cannot know
  fiohost diagnose measured_log.csv --report report   what does a linear model lack?

With a board:
  fiohost devices                                     what is connected
  fiohost doctor                                      is all right between this computer and the motor?

fiohost --help lists all commands, fiohost COMMAND --help explains one, fiohost completion helps the tab key."""

MOST_LINES = 10_000  # of what is logged, that a slow reader may be behind
FLUSH_S = 1.0


class Commands(LazyCommands):
    """All commands; errors become one sentence and an exit code."""

    table = COMMANDS
    groups = GROUPS

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        command = super().get_command(ctx, cmd_name)
        if command is None:
            return None
        taken = {option for parameter in command.params for option in parameter.opts}
        if not taken & {"-v", "--verbose", "--debug"}:
            command.params += [_verbose_option(), _debug_option()]
        return command

    def invoke(self, ctx: click.Context) -> Any:
        from fiohost import files

        try:
            with files.command():
                return super().invoke(ctx)
        except FiohostError as exc:
            _say_error(exc)
            _leave(1)
        except KeyboardInterrupt as exc:  # Stopped is one
            _say(f"\n{exc}" if str(exc) else "\nstopped by Ctrl-C")
            _say_notes(exc)
            _leave(getattr(exc, "exit_code", 130))
        except click.UsageError as exc:
            text = files.shortened(files.escaped(exc.format_message()))
            raise click.UsageError(text, exc.ctx) from exc
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except Exception as exc:
            if isinstance(exc, OSError) and exc.errno in OUTPUT_ENDED and exc.filename is None:
                if not isinstance(exc, BrokenPipeError):  # a reader who leaves has seen enough
                    _say(f"fiohost: what there is to say cannot be written: {exc.strerror}")
            elif logging.getLogger("fiohost").isEnabledFor(logging.DEBUG):
                raise
            else:
                text = " ".join(str(exc).split())[:300]
                _say(f"fiohost: error inside fiohost: {type(exc).__name__}: {text} (--debug shows where)")
            _say_notes(exc)
            _leave(1)


def _say_error(exc: FiohostError) -> None:
    _say(f"fiohost: {exc}")
    _say_notes(exc)
    if logging.getLogger("fiohost").isEnabledFor(logging.DEBUG):
        logging.getLogger("fiohost").debug("where:", exc_info=exc)


def _say_notes(exc: BaseException) -> None:
    for note in getattr(exc, "__notes__", ()):
        _say(f"fiohost: {note}")


def _say(text: str) -> None:
    from fiohost.files import escaped, shortened

    for handler in logging.getLogger("fiohost").handlers:
        handler.flush()  # what was said before comes before
    with suppress(OSError):  # the terminal may have gone
        click.echo(shortened(escaped(text)), err=True)


def _leave(code: int) -> NoReturn:
    """Exit with this code, also where what was said last can no longer be written."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    sys.exit(code)


class _Hearsay(logging.Handler):
    """Writes what fiohost logs to standard error in a thread of its own: a reader who has stopped reading must not hold
    up a loop that drives.
    """

    def __init__(self) -> None:
        from fiohost.background import Background

        super().__init__()
        stream = sys.stderr

        def write(line: str) -> None:
            with suppress(OSError, ValueError):  # the terminal may have gone
                stream.write(line)
                stream.flush()

        self._behind = Background(write, MOST_LINES, "said")
        self._lost = 0
        self.setFormatter(logging.Formatter("%(name)s: %(message)s"))

    def emit(self, record: logging.LogRecord) -> None:
        lost, self._lost = self._lost, 0
        line = self.format(record) + "\n"
        if lost:
            line = f"({lost} lines left out: nobody reads as fast)\n" + line
        if not self._behind.put(line):
            self._lost = lost + 1

    def flush(self) -> None:
        self._behind.flush(FLUSH_S)

    def close(self) -> None:
        self._behind.close()
        super().close()


def _hear(level: int) -> None:
    logger = logging.getLogger("fiohost")
    if not logger.handlers:
        logger.addHandler(_Hearsay())
        logger.propagate = False
    logger.setLevel(min(level, logger.level or level))


def _warned(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """What a library warns of is for who looks for a fault (--debug), not for who drives a motor."""
    logging.getLogger("fiohost").debug("%s:%d: %s: %s", filename, lineno, category.__name__, message)


def _set_level(ctx: click.Context, parameter: click.Parameter, value: int | bool) -> None:
    if not value:
        return
    level = logging.DEBUG if parameter.name == "debug" else logging.INFO
    _hear(level)


def _verbose_option() -> click.Option:
    return click.Option(["-v", "--verbose"], is_flag=True, expose_value=False, callback=_set_level, help="Say more.")


def _debug_option() -> click.Option:
    text = "Show traffic in hex, and where an error came from."
    return click.Option(["--debug"], is_flag=True, expose_value=False, callback=_set_level, help=text)


@click.group(
    cls=Commands,
    params=[_verbose_option(), _debug_option()],
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog="Example: fiohost manual --pwm 40 --duration 5",
    invoke_without_command=True,
)
@click.version_option(__version__, prog_name="fiohost")
@click.pass_context
def cli(ctx: click.Context) -> None:
    """Drive a DC-motor control bench, log it, identify it, and name what its model lacks."""
    if ctx.invoked_subcommand is None:
        click.echo(START)


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the ``fiohost`` command."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by whoever started us
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 (for as long as the process lives)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # a locale that has no umlauts ends no command
    _hear(logging.WARNING)
    if not sys.warnoptions:  # python -W asks for them
        warnings.showwarning = _warned
    cli.main(args=list(arguments) if arguments is not None else None, prog_name="fiohost")


if __name__ == "__main__":
    main()
