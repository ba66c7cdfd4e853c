"""Models and controllers as objects of python-control (https://python-control.org)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from fiohost.control.settings import ControlSettings
from fiohost.errors import ConfigError
from fiohost.motor.model import Model

if TYPE_CHECKING:
    from control import StateSpace, TransferFunction

OUTPUTS = ("angle", "speed")


def to_control(model: Model, output: str = "angle") -> TransferFunction:
    """The linear part of a model, from duty (percent) to ``angle`` (deg) or ``speed`` (deg/s), continuous.

    It is K / (tau s + 1), with another 1/s for the angle. Effects are not in it: what is linear in them (an inductance,
    a delay) neither. Raises ConfigError without the library.
    """
    control = _library()
    if output not in OUTPUTS:
        raise ConfigError(f"the output of a model is {' or '.join(OUTPUTS)}, not {output!r}")
    gain, lag = model.number("linear.gain_deg_s_per_pct"), model.number("linear.tau_s")
    denominator = [lag, 1.0, 0.0] if output == "angle" else [lag, 1.0]
    unit = model.unit if output == "angle" else f"{model.unit}_s"
    return control.TransferFunction([gain], denominator, inputs=["duty_pct"], outputs=[f"{output}_{unit}"])


def controller_to_control(settings: ControlSettings, sample_time_s: float) -> StateSpace:
    """A controller between its limits, discrete, with the inputs ``ref_deg`` and ``angle_deg`` and the output
    ``duty_pct``: without deadband compensation, threshold and limit.

    Its states are what is differentiated, at the last tick; its filtered slope; the integral. It begins at zero, so
    that a first reading other than zero gives a kick. Raises ConfigError.
    """
    control = _library()
    settings.law(sample_time_s)  # refuses what is none
    integrates, differentiates = settings.kind in ("pi", "pid"), settings.kind in ("pd", "pid")
    ki = settings.ki_pct_per_deg_s * sample_time_s if integrates else 0.0
    kd = settings.kd_pct_s_per_deg if differentiates else 0.0
    keep = settings.filter_s / (settings.filter_s + sample_time_s)
    new = 1.0 / (settings.filter_s + sample_time_s)
    error = np.array([1.0, -1.0])
    signal = np.array([0.0, -1.0]) if settings.derivative_on == "angle" else error
    return control.StateSpace(
        np.array([[0.0, 0.0, 0.0], [-new, keep, 0.0], [0.0, 0.0, 1.0]]),
        np.array([signal, new * signal, ki * error]),
        np.array([[-kd * new, kd * keep, 1.0]]),
        np.array([(settings.kp_pct_per_deg + ki) * error + kd * new * signal]),
        sample_time_s,
        inputs=["ref_deg", "angle_deg"],
        outputs=["duty_pct"],
        states=["before_deg", "slope_deg_s", "integral_pct"],
    )


def _library() -> Any:
    try:
        import control
    except ImportError:
        raise ConfigError("objects of python-control need the library: pip install 'fiohost[export]'") from None
    return control
