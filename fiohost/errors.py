"""One tree of errors. Each message says what happened, the likely cause and the next step, in one sentence.

The command line prints the message and exits 1; nothing else is caught there.
"""

from __future__ import annotations


class FiohostError(Exception):
    """Root of all errors that a user can cause or cure."""


class ConfigError(FiohostError):
    """A file or value that people write is wrong: unknown key, value out of range, unknown name."""


class LogError(FiohostError):
    """A log or table cannot be read or written."""


class ModelError(FiohostError):
    """A model, effect or parameter is unknown, malformed or cannot be simulated."""


class DataError(FiohostError):
    """The data are readable but cannot answer the question asked of them."""


class TransportError(FiohostError):
    """Something between the host and the board failed."""


class DisconnectedError(TransportError):
    """The board went away: unplugged, reset, or its line hung up."""


class TelemetryTimeoutError(TransportError):
    """No telemetry arrived in time."""


class MotorRunningError(TransportError):
    """The brake was sent, but nothing says that the shaft stands."""


class HostError(FiohostError):
    """This computer did not keep up: a run on a real board was ended and the motor braked."""


class ReportError(TransportError):
    """A report does not fit its layout; ``reason`` is one word for counting: length, header, crc, values, ..."""

    def __init__(self, message: str, reason: str = "values") -> None:
        super().__init__(message)
        self.reason = reason


class GuardError(FiohostError):
    """The motor does not do what it is told: it stands, turns the wrong way, or its encoder cannot be believed."""


class LimitError(FiohostError):
    """A command or run exceeds a limit of the bench."""
