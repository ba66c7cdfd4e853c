"""The fit's simulation against other simulators of the same equations: how much faster, and how near to the truth.

    python benchmarks/simulators.py [--json FILE]

Peers (scipy, python-control, casadi, mujoco, gym-electric-motor) are installed into an environment of their own. Each
runs the same commands on the same equations, as its own pages tell one to: scipy with events that find where the shaft
stops; python-control and casadi with dry friction smoothed over a thousandth of top speed, for want of events; mujoco
with its friction loss; gym-electric-motor with its own motor, load and solver. The truth is scipy's DOP853 with events,
at a tolerance of 1e-11. Times are the processor's, the best of a few runs, compilation and set-up left out.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import peers

peers.among()

import casadi  # noqa: E402
import control  # noqa: E402
import mujoco  # noqa: E402
import mujoco.rollout  # noqa: E402
import numpy as np  # noqa: E402
from kernel import DRY, RECORDS, commands, model_of, numba_side  # noqa: E402
from scipy.integrate import solve_ivp  # noqa: E402

from fiohost.motor.state import THETA  # noqa: E402

BEGIN_DEG = 0.2
GAIN, TAU, LEVEL = (DRY[k] for k in ("linear.gain_deg_s_per_pct", "linear.tau_s", "coulomb_friction.level_pct"))
MASS = TAU / GAIN
SMOOTH_DEG_S = 1e-3 * 100.0 * GAIN
Run = Callable[[], np.ndarray]


@dataclass(frozen=True)
class Motor:
    """Percent of duty, degrees and seconds: mass omega' = duty - omega / gain - friction + cogging - spring; a second
    inertia behind the spring where a ``share`` of the mass is there, and a winding that lags by ``lag_s``.
    """

    record: str
    lag_s: float = 0.0
    extra: float = 0.0
    stribeck_deg_s: float = 60.0
    order: float = 0.0
    cogging: float = 0.0
    phase_deg: float = 30.0
    share: float = 0.0
    resonance_hz: float = 12.0
    damping: float = 0.05

    @property
    def own(self) -> float:
        return MASS * (1.0 - self.share)

    @property
    def other(self) -> float:
        return MASS * self.share

    @property
    def stiff(self) -> float:
        return MASS * self.share * (1.0 - self.share) * (2.0 * math.pi * self.resonance_hz) ** 2

    @property
    def damp(self) -> float:
        return 2.0 * MASS * self.share * (1.0 - self.share) * self.damping * 2.0 * math.pi * self.resonance_hz

    @property
    def size(self) -> int:
        """How many states there are: angle, speed, then current, then angle and speed of the load."""
        return 2 + bool(self.lag_s) + 2 * bool(self.share)

    def parts(self) -> dict[str, dict[str, Any]]:
        """The same for our own model."""
        found: dict[str, dict[str, Any]] = {}
        if self.lag_s:
            found["armature_inductance"] = {"time_constant_s": self.lag_s}
        if self.extra:
            found["stribeck_friction"] = {"extra_pct": self.extra, "stribeck_speed_deg_s": self.stribeck_deg_s}
        if self.cogging:
            found["cogging_torque"] = {"order": self.order, "level_pct": self.cogging, "phase_deg": self.phase_deg}
        if self.share:
            found["shaft_compliance"] = {"resonance_hz": self.resonance_hz, "damping_ratio": self.damping,
                                         "inertia_ratio": self.share}  # fmt: skip
        return found

    def push(self, y: Any, duty: Any, sin: Callable[..., Any] = math.sin) -> Any:
        """What drives the motor, friction left out."""
        current = y[2] if self.lag_s else duty - y[1] / GAIN
        if self.cogging:
            current = current - self.cogging * sin((self.order * y[0] + self.phase_deg) * (math.pi / 180.0))
        if self.share:
            twist, slip = y[0] - y[-2], y[1] - y[-1]
            current = current - self.stiff * twist - self.damp * slip
        return current

    def level(self, speed: Any, exp: Callable[..., Any] = math.exp, size: Callable[..., Any] = abs) -> Any:
        """The friction that opposes a speed."""
        return LEVEL + self.extra * exp(-size(speed) / self.stribeck_deg_s) if self.extra else LEVEL

    def rates(self, y: Any, duty: Any, speed_rate: Any) -> list[Any]:
        """Derivatives of all states, that of the motor's speed being given."""
        found = [y[1], speed_rate]
        if self.lag_s:
            found.append((duty - y[1] / GAIN - y[2]) / self.lag_s)
        if self.share:
            found += [y[-1], (self.stiff * (y[0] - y[-2]) + self.damp * (y[1] - y[-1])) / self.other]
        return found


def pieces(duties: np.ndarray) -> list[tuple[int, int]]:
    """First tick and that after the last of each stretch of one duty (n)."""
    edges = [0, *(np.flatnonzero(np.diff(duties)) + 1).tolist(), len(duties)]
    return list(zip(edges[:-1], edges[1:], strict=True))


def between(motor: Motor, duty: float, way: float, began: float) -> tuple[Any, Any]:
    """Rates of a shaft that turns one ``way`` (0: is held), and what ends that: it comes to rest, or breaks away."""

    def rates(t: float, y: np.ndarray) -> list[Any]:
        force = motor.push(y, duty) - way * motor.level(y[1]) if way != 0.0 else 0.0
        return motor.rates(y, duty, force / motor.own)

    def event(t: float, y: np.ndarray) -> float:
        if way == 0.0:
            return float(motor.level(0.0) - abs(motor.push(y, duty)))
        return float(y[1] * way) if t > began + 1e-12 else 1.0

    event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
    return rates, event


def with_events(motor: Motor, method: str, rtol: float) -> Run:
    """scipy, stretch by stretch of one duty, and within it from one stop or start of the shaft to the next."""
    at, duties = commands(*RECORDS[motor.record])

    def run() -> np.ndarray:
        x = np.zeros(motor.size)
        x[0] = BEGIN_DEG
        if motor.share:
            x[-2] = BEGIN_DEG
        angles = np.empty(len(at))
        angles[0] = BEGIN_DEG
        for a, b in pieces(duties):
            now, end, duty = at[a], at[min(b, len(at) - 1)], duties[a]
            while now < end:
                pull = motor.push(x, duty)
                stuck = x[1] == 0.0 and abs(pull) <= motor.level(0.0)
                way = 0.0 if stuck else math.copysign(1.0, x[1] if x[1] != 0.0 else pull)

                rates, event = between(motor, duty, way, now)
                inner = at[(at > now + 1e-12) & (at <= end + 1e-12)]
                found = solve_ivp(rates, (now, end), x, method, t_eval=inner, events=event, rtol=rtol, atol=rtol)
                if len(inner) and len(found.t):
                    first = int(np.searchsorted(at, now + 1e-12, side="right"))
                    angles[first : first + found.y.shape[1]] = found.y[0]
                if found.status == 1:
                    now, x = float(found.t_events[0][0]), found.y_events[0][0].copy()
                    if way != 0.0:
                        x[1] = 0.0
                    else:
                        x[1] = 1e-12 * math.copysign(1.0, motor.push(x, duty))
                else:
                    now, x = end, found.y[:, -1].copy()
        return angles

    return run


def own(motor: Motor) -> Run:
    run, states = numba_side(model_of(motor.parts()), motor.record)

    def angles() -> np.ndarray:
        run()
        return states[:, THETA]

    return angles


def smoothed(motor: Motor, y: Any, duty: Any, of: Any, size: Callable[..., Any]) -> list[Any]:
    """All rates, with dry friction as a steep slope through zero speed; functions are those ``of`` a module."""
    friction = motor.level(y[1], of.exp, size) * of.tanh(y[1] / SMOOTH_DEG_S)
    return motor.rates(y, duty, (motor.push(y, duty, of.sin) - friction) / motor.own)


def by_control(motor: Motor) -> Run:
    """python-control joins inputs by lines: each duty is given at both ends of its tick."""
    at, duties = commands(*RECORDS[motor.record])
    tick = at[1] - at[0]
    times = np.column_stack((at, at + tick - 1e-7)).ravel()[:-1]
    inputs = np.repeat(duties, 2)[:-1]
    begin = [BEGIN_DEG if i in (0, motor.size - 2 if motor.share else 0) else 0.0 for i in range(motor.size)]
    system = control.nlsys(
        lambda t, x, u, params: smoothed(motor, x, u[0], math, abs),
        None, inputs=1, states=motor.size, outputs=motor.size,
    )  # fmt: skip

    def run() -> np.ndarray:
        found = control.input_output_response(
            system, times, inputs, begin, solve_ivp_method="LSODA",
            solve_ivp_kwargs={"rtol": 1e-6, "atol": 1e-6, "max_step": tick},
        )  # fmt: skip
        return np.asarray(found.states[0][::2])

    return run


def by_casadi(motor: Motor) -> Run:
    """Runge-Kutta steps of a quarter of a millisecond, over a grid of ticks each with its own duty; its cvodes gives up
    where the friction turns.
    """
    at, duties = commands(*RECORDS[motor.record])
    x, u = casadi.SX.sym("x", motor.size), casadi.SX.sym("u")
    rates = smoothed(motor, [x[i] for i in range(motor.size)], u, casadi, casadi.fabs)
    whole = casadi.integrator(
        "whole", "rk", {"x": x, "u": u, "ode": casadi.vertcat(*rates)}, float(at[0]), at[1:].tolist(),
        {"number_of_finite_elements": round(float(at[-1] - at[0]) / 0.00025)},
    )  # fmt: skip
    begin = [BEGIN_DEG if i in (0, motor.size - 2 if motor.share else 0) else 0.0 for i in range(motor.size)]

    def run() -> np.ndarray:
        found = whole(x0=begin, u=duties[None, :-1])["xf"]
        return np.concatenate(([BEGIN_DEG], np.asarray(found)[0]))

    return run


def by_mujoco(motor: Motor) -> Run | None:
    """Joints in degrees, an actuator of percents of duty; what it has no name for (Stribeck, cogging) it cannot do."""
    if motor.extra or motor.cogging or motor.lag_s:
        return None
    at, duties = commands(*RECORDS[motor.record])
    every = max(1, round((at[1] - at[0]) / 0.001))
    step = (at[1] - at[0]) / every
    load = ""
    spring = ""
    if motor.share:
        load = f'<body><joint name="load" type="slide" axis="1 0 0" />{of_mass(motor.other)}</body>'
        # A spring between the two is a tendon of their difference.
        spring = f"""<tendon><fixed name="spring" stiffness="{motor.stiff}" damping="{motor.damp}" springlength="0">
          <joint joint="motor" coef="1"/><joint joint="load" coef="-1"/></fixed></tendon>"""
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>
      <option timestep="{step}" gravity="0 0 0" integrator="implicitfast" tolerance="1e-12"/>
      <worldbody>
        <body><joint name="motor" type="slide" axis="1 0 0" damping="{1.0 / GAIN}"
          frictionloss="{LEVEL}" solreffriction="{2.0 * step} 1" solimpfriction="0.9999 0.9999 0.001"/>
          {of_mass(motor.own)}</body>
        {load}
      </worldbody>{spring}
      <actuator><motor joint="motor"/></actuator></mujoco>""")
    data = mujoco.MjData(model)
    data.qpos[:] = BEGIN_DEG
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    begin = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, begin, kind)
    inputs = np.repeat(duties[:-1], every)[None, :, None]

    def run() -> np.ndarray:
        found, _ = mujoco.rollout.rollout(model, data, begin[None], inputs)
        return np.concatenate(([BEGIN_DEG], found[0, every - 1 :: every, 1]))

    return run


def of_mass(mass: float) -> str:
    """A body of this mass that touches nothing."""
    return f'<geom size="0.01" mass="{mass}" contype="0" conaffinity="0"/>'


def by_gem(motor: Motor) -> Run | None:
    """gym-electric-motor: speeds over the gain, one ohm, volts of percents; its speed is summed up to an angle."""
    if motor.extra or motor.cogging or motor.share or not motor.lag_s:
        return None
    import gym_electric_motor.physical_systems as gem

    at, duties = commands(*RECORDS[motor.record])
    tick = float(at[1] - at[0])
    system = gem.DcMotorSystem(
        converter=gem.ContFourQuadrantConverter(),
        motor=gem.DcPermanentlyExcitedMotor(
            motor_parameter={"r_a": 1.0, "l_a": motor.lag_s, "psi_e": 1.0, "j_rotor": 0.5 * TAU}
        ),
        load=gem.PolynomialStaticLoad(load_parameter={"a": LEVEL, "b": 0.0, "c": 0.0, "j_load": 0.5 * TAU}),
        supply=gem.IdealVoltageSupply(u_nominal=100.0),
        ode_solver=gem.ScipyOdeSolver("dopri5", rtol=1e-6, atol=1e-6, nsteps=10_000),
        tau=tick,
    )
    actions = duties[:, None] / 100.0

    def run() -> np.ndarray:
        system.reset()
        speeds = np.zeros(len(at))
        for k in range(len(at) - 1):
            system.simulate(actions[k])
            speeds[k + 1] = system.system_state[0] * GAIN
        return BEGIN_DEG + np.concatenate(([0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * tick)))

    return run


MOTORS = {
    "dry friction": Motor("20 s at 5 ms"),
    "dry friction, winding that lags": Motor("20 s at 5 ms", lag_s=0.004),
    "dry friction, second inertia on a spring": Motor("10 s at 1 ms", share=0.3),
    "Stribeck, cogging, second inertia": Motor("10 s at 1 ms", extra=2.0, order=12.0, cogging=1.5, share=0.3),
}
PEERS: dict[str, tuple[str, Callable[[Motor], Run | None]]] = {
    "scipy solve_ivp": ("scipy", lambda motor: with_events(motor, "RK45", 1e-6)),
    "python-control": ("control", by_control),
    "casadi": ("casadi", by_casadi),
    "mujoco": ("mujoco", by_mujoco),
    "gym-electric-motor": ("gym-electric-motor", by_gem),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--only", default="", help="some of the models, by their numbers: 0,2")
    given = parser.parse_args()
    chosen = [list(MOTORS)[int(i)] for i in given.only.split(",")] if given.only else list(MOTORS)
    rows: list[dict[str, Any]] = []
    print(f"{'':24}{'us a simulated s':>18}{'times ours':>12}{'furthest from the truth, deg':>30}")
    for name in chosen:
        motor = MOTORS[name]
        span_s = RECORDS[motor.record][0]
        print(f"{name}, {motor.record}", flush=True)
        truth = with_events(motor, "DOP853", 1e-11)()
        mine = own(motor)
        base = peers.seconds(mine, 0.2, 2000)
        ran: dict[str, tuple[float, float]] = {"fiohost": (base, furthest(mine(), truth))}
        for peer, (_, make) in PEERS.items():
            run = make(motor)
            if run is None:
                print(f"  {peer:22}{'cannot':>18}")
                continue
            try:
                ran[peer] = (peers.seconds(run, 1.0, 10), furthest(run(), truth))
            except RuntimeError as exc:
                print(f"  {peer:22}{'failed':>18}  {str(exc).splitlines()[-1][:70]}")
        for peer, (span, apart) in ran.items():
            print(f"  {peer:22}{1e6 * span / span_s:18.1f}{span / base:12.0f}{apart:30.2g}", flush=True)
            rows.append({"model": name, "peer": peer, "s": span, "span_s": span_s, "times": span / base, "deg": apart})
    print(peers.versions(*(package for package, _ in PEERS.values())))
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1) + "\n")


def furthest(angles: np.ndarray, truth: np.ndarray) -> float:
    return float(np.max(np.abs(angles - truth)))


if __name__ == "__main__":
    main()
