"""A model and a controller as a MATLAB script that needs no toolbox; GNU Octave runs it too."""

from __future__ import annotations

from fiohost import __version__
from fiohost.control.settings import ControlSettings
from fiohost.motor.model import Model

MODEL = """\
% {expression}: written by fiohost {version}.
% gain in deg/s per percent of duty, lag in s. Effects beyond the linear part are listed below and are not simulated.
model.gain_deg_s_per_pct = {gain!r};
model.tau_s = {lag!r};
{effects}
% With the Control System Toolbox: from duty (percent) to angle (deg)
%   G = tf(model.gain_deg_s_per_pct, [model.tau_s 1 0]);
"""
CONTROLLER = """
% {kind} controller, tick {tick!r} s
c.Ts = {tick!r};
{numbers}
"""
LOOP = """
% The step response of both in closed loop: the duty acts a tick after the reading that it answers.
reference_deg = {step!r};
n = round({seconds!r} / c.Ts);
t = (0:n-1)' * c.Ts; angle = zeros(n, 1); duty = zeros(n, 1);
theta = 0; omega = 0; acting = 0;
s.before = 0; s.slope = 0; s.integral = 0; s.first = true;
keep = exp(-c.Ts / model.tau_s);
for k = 1:n
    angle(k) = theta;
    [duty(k), s] = fiohost_controller(c, s, reference_deg, theta);
    target = model.gain_deg_s_per_pct * acting;
    theta = theta + target * c.Ts + (omega - target) * model.tau_s * (1 - keep);
    omega = target + (omega - target) * keep;
    acting = duty(k);
end
"""
PLOT = """
if exist('fiohost_no_plot', 'var') == 0
    subplot(2, 1, 1); plot(t, angle, t, reference_deg + 0 * t); ylabel('angle (deg)'); grid on
    subplot(2, 1, 2); stairs(t, duty); ylabel('duty (%)'); xlabel('time (s)'); grid on
end
"""
FUNCTION = """
function [duty, s] = fiohost_controller(c, s, reference_deg, angle_deg)
    e = reference_deg - angle_deg;
    s.integral = s.integral + c.ki * c.Ts * e;
    if c.on_angle, signal = -angle_deg; else, signal = e; end
    if s.first, change = 0; s.first = false; else, change = signal - s.before; end
    s.before = signal;
    s.slope = c.filter_s / (c.filter_s + c.Ts) * s.slope + change / (c.filter_s + c.Ts);
    wanted = c.kp * e + c.kd * s.slope + s.integral;
    compensated = 0;
    if wanted > c.threshold, compensated = wanted + c.u_plus; end
    if wanted < -c.threshold, compensated = wanted + c.u_minus; end
    duty = min(max(compensated, -c.limit), c.limit);
    if c.ki ~= 0
        back = c.Ts / max(c.tracking_s, c.Ts) * (duty - compensated);
        if back < 0
            s.integral = max(s.integral + back, min(s.integral, 0));
        else
            s.integral = min(s.integral + back, max(s.integral, 0));
        end
    end
end
"""


def matlab_script(
    model: Model,
    settings: ControlSettings | None = None,
    sample_time_s: float = 0.005,
    step_deg: float = 90.0,
    seconds: float = 2.0,
) -> str:
    """The script's text: the model, and with *settings* the controller and a step response of both."""
    numbers = [f"% {key} = {value}" for key, value in model.values.items() if not key.startswith("linear.")]
    text = MODEL.format(
        expression=model.expression,
        version=__version__,
        gain=model.number("linear.gain_deg_s_per_pct"),
        lag=model.number("linear.tau_s"),
        effects="\n".join(numbers),
    )
    if settings is None:
        return text
    settings.law(sample_time_s)  # refuses what is none
    differentiates, integrates = settings.kind in ("pd", "pid"), settings.kind in ("pi", "pid")
    told = {
        "kp": settings.kp_pct_per_deg,
        "ki": settings.ki_pct_per_deg_s if integrates else 0.0,
        "kd": settings.kd_pct_s_per_deg if differentiates else 0.0,
        "filter_s": settings.filter_s,
        "tracking_s": settings.tracking_s,
        "limit": settings.limit_pct,
        "u_plus": settings.u_plus_pct,
        "u_minus": settings.u_minus_pct,
        "threshold": settings.threshold_pct,
    }
    lines = [f"c.{key} = {value!r};" for key, value in told.items()]
    lines.append(f"c.on_angle = {'true' if settings.derivative_on == 'angle' else 'false'};")
    control = CONTROLLER.format(kind=settings.kind.upper(), tick=sample_time_s, numbers="\n".join(lines))
    # a script that begins with a function would be taken for a file of functions: 1; makes it none
    return f"1;\n{FUNCTION.lstrip()}\n{text}{control}{LOOP.format(step=step_deg, seconds=seconds)}{PLOT}"
