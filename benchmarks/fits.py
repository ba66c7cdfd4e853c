"""A fit of one structure to 60 s of log, against other programs that identify: time, and error on a log that none saw.

    python benchmarks/fits.py [--seed N] [--json FILE]

The simulated board has gain, lag and dry friction; its encoder has half a degree a count. lmfit and scipy's least
squares fit whole runs over the same kernel as ours, from the same first values; mujoco's sysid simulates by mujoco.
pysindy (rates as sums of terms in speed, its sign and the duty) and sysidentpy (a NARX polynomial of the speed) are
given the derivative that they need. Each then simulates the held-out log freely from its first angle, at rest. Times
are the processor's, the best of a few runs.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import secrets
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import peers

peers.among()

import lmfit  # noqa: E402
import mujoco  # noqa: E402
import mujoco.rollout  # noqa: E402
import numpy as np  # noqa: E402
import pysindy  # noqa: E402
from mujoco import sysid  # noqa: E402
from scipy.integrate import solve_ivp  # noqa: E402
from scipy.optimize import least_squares  # noqa: E402
from sysidentpy.basis_function import Polynomial  # noqa: E402
from sysidentpy.model_structure_selection import FROLS  # noqa: E402
from sysidentpy.parameter_estimation import LeastSquares  # noqa: E402

from fiohost.bench.experiment import Experiment  # noqa: E402
from fiohost.bench.loop import Bench  # noqa: E402
from fiohost.bench.signals import RandomSteps  # noqa: E402
from fiohost.estimation.fit import fit_from_scratch  # noqa: E402
from fiohost.estimation.predict import Flat, free_output  # noqa: E402
from fiohost.estimation.record import Record, record_from_log  # noqa: E402
from fiohost.motor.model import Model  # noqa: E402
from fiohost.motor.simulate import Start  # noqa: E402
from fiohost.transport.profile import TargetProfile  # noqa: E402
from fiohost.transport.simulated import SimulatedTransport  # noqa: E402
from firmware_model import Board  # noqa: E402
from firmware_model.plants import load_plant  # noqa: E402

STRUCTURE = "linear+coulomb_friction"
NAMES = ("linear.gain_deg_s_per_pct", "linear.tau_s", "coulomb_friction.level_pct")
FIRST = (8.0, 0.15, 2.0)
LOW, HIGH = (0.1, 0.005, 0.0), (100.0, 2.0, 20.0)
FIT_S, HELD_S = 60.0, 30.0
STEPS_A_TICK = 5
# The speed that pysindy and sysidentpy work with is taken over so many ticks on either side.
SLOPE_TICKS = 4
Values = tuple[float, float, float]
Simulate = Callable[[Record], np.ndarray]


def measured(seed: int) -> tuple[Record, Record]:
    """The log to fit and the held-out one, of one board."""
    board = Board(load_plant("ideal"), seed=seed)
    records = []
    with Bench(SimulatedTransport(board.step, "sim", "simulated"), TargetProfile.load()) as bench:
        for k, span in enumerate((FIT_S, HELD_S)):
            steps = RandomSteps(duration_s=span, low=-80.0, high=80.0, hold_min_s=0.2, hold_max_s=1.5, seed=seed + k)
            records.append(record_from_log(bench.run(Experiment("steps", [steps]))))
    return records[0], records[1]


def begun(record: Record) -> Start:
    """At rest in the middle of the first count."""
    return Start(float(record.y[0]) + 0.5 * record.quantum, 0.0)


def motor(values: Values) -> Model:
    return Model.parse(STRUCTURE).with_values(dict(zip(NAMES, map(float, values), strict=True)))


def kernel(values: Values) -> Simulate:
    flat = Flat.of(motor(values))
    return lambda record: free_output(record, flat, begun(record))


def ours(record: Record) -> Simulate:
    found = fit_from_scratch(Model.parse(STRUCTURE), [record]).model
    return kernel(tuple(found.number(n) for n in NAMES))  # type: ignore[arg-type]


def by_scipy(record: Record) -> Simulate:
    def residual(x: np.ndarray) -> np.ndarray:
        return record.y - kernel(tuple(x))(record)  # type: ignore[arg-type]

    return kernel(tuple(least_squares(residual, FIRST, bounds=(LOW, HIGH), x_scale=FIRST).x))  # type: ignore[arg-type]


def by_lmfit(record: Record) -> Simulate:
    parameters = lmfit.Parameters()
    for name, value, low, high in zip(("gain", "tau", "level"), FIRST, LOW, HIGH, strict=True):
        parameters.add(name, value=value, min=low, max=high)

    def residual(p: lmfit.Parameters) -> np.ndarray:
        return record.y - kernel((p["gain"].value, p["tau"].value, p["level"].value))(record)

    found = lmfit.minimize(residual, parameters).params
    return kernel((found["gain"].value, found["tau"].value, found["level"].value))


def duties(record: Record) -> np.ndarray:
    """What acts from each sample on, which the log knows to be one tick late."""
    return record.acting_pct


def by_mujoco(record: Record) -> Simulate:
    tick = record.sample_time_s

    def spec_of(values: Values) -> mujoco.MjSpec:
        gain, tau, level = values
        step = tick / STEPS_A_TICK
        return mujoco.MjSpec.from_string(f"""<mujoco><option timestep="{step}" gravity="0 0 0"
          integrator="implicitfast"/><worldbody><body name="rotor"><joint name="motor" type="slide" axis="1 0 0"
          damping="{1.0 / gain}" frictionloss="{level}" solreffriction="{2.0 * step} 1"
          solimpfriction="0.9999 0.9999 0.001"/>
          <geom name="iron" size="0.01" mass="{tau / gain}" contype="0" conaffinity="0"/></body>
          </worldbody><actuator><motor name="drive" joint="motor"/></actuator>
          <sensor><jointpos name="angle" joint="motor"/></sensor></mujoco>""")

    def simulate(values: Values, record: Record) -> np.ndarray:
        model = spec_of(values).compile()
        begin = sysid.create_initial_state(model, np.array([begun(record).angle]), np.zeros(1))
        inputs = np.repeat(duties(record)[:-1], STEPS_A_TICK)[None, :, None]
        states, _ = mujoco.rollout.rollout(model, mujoco.MjData(model), np.asarray(begin)[None], inputs)
        return np.concatenate(([begun(record).angle], states[0, STEPS_A_TICK - 1 :: STEPS_A_TICK, 1]))

    spec = spec_of(FIRST)
    model = spec.compile()
    n = len(record)
    fine = np.arange((n - 1) * STEPS_A_TICK + 1) * (tick / STEPS_A_TICK)
    control = sysid.TimeSeries(fine, np.repeat(duties(record), STEPS_A_TICK)[: len(fine), None])
    seen = sysid.TimeSeries.from_names(np.arange(n) * tick, record.y[:, None], model)
    begin = sysid.create_initial_state(model, np.array([begun(record).angle]), np.zeros(1))
    parameters = sysid.ParameterDict()

    # gain, lag and friction are its damping, inertia and friction loss; these are what it can be asked for
    def inertia(spec: mujoco.MjSpec, p: sysid.Parameter) -> None:
        spec.geom("iron").mass = float(p.value[0])

    def damping(spec: mujoco.MjSpec, p: sysid.Parameter) -> None:
        joint = spec.joint("motor")
        joint.damping = float(p.value[0]) if np.ndim(joint.damping) == 0 else [float(p.value[0]), 0.0, 0.0]

    def friction(spec: mujoco.MjSpec, p: sysid.Parameter) -> None:
        spec.joint("motor").frictionloss = float(p.value[0])

    for name, first, low, high, change in (
        ("inertia", FIRST[1] / FIRST[0], 1e-4, 1.0, inertia),
        ("damping", 1.0 / FIRST[0], 0.01, 1.0, damping),
        ("friction", FIRST[2], LOW[2], HIGH[2], friction),
    ):
        parameters.add(sysid.Parameter(name, nominal=first, min_value=low, max_value=high, modifier=change))
    sequences = sysid.ModelSequences("motor", spec, "run", begin, control, seen)
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    with contextlib.redirect_stdout(io.StringIO()):
        found, _ = sysid.optimize(initial_params=parameters, residual_fn=residual, optimizer="mujoco", verbose=False)
    m, d, level = (float(found[name].value[0]) for name in ("inertia", "damping", "friction"))
    return lambda other: simulate((1.0 / d, m / d, level), other)


def speed(record: Record) -> np.ndarray:
    """Slope (n) of the readings over some ticks on either side."""
    k = SLOPE_TICKS
    padded = np.concatenate((np.full(k, record.y[0]), record.y, np.full(k, record.y[-1])))
    return (padded[2 * k :] - padded[: -2 * k]) / (2.0 * k * record.sample_time_s)


def by_pysindy(record: Record) -> Simulate:
    """The speed's rate as a sum of terms: speed, duty, and a friction of tanh of the speed."""
    terms = pysindy.CustomLibrary(
        library_functions=[lambda x: x, lambda x: np.tanh(x / 5.0)], function_names=[lambda x: x, lambda x: f"tanh {x}"]
    )
    w, u = speed(record), duties(record)
    model = pysindy.SINDy(
        optimizer=pysindy.STLSQ(threshold=0.0),
        feature_library=terms,
        differentiation_method=pysindy.SmoothedFiniteDifference(),
    )
    model.fit(w[:, None], t=record.sample_time_s, u=u[:, None])
    by = dict(zip(model.get_feature_names(), model.coefficients()[0], strict=True))
    a, c = by["x0"], by["tanh x0"]
    b, d = by["u0"], by["tanh u0"]

    def simulate(other: Record) -> np.ndarray:
        at, acting = other.excitation.times_s, duties(other)
        y = np.array([begun(other).angle, 0.0])
        found = [y[0]]
        edges = [0, *(np.flatnonzero(np.diff(acting)) + 1).tolist(), len(acting) - 1]
        for i, j in zip(edges[:-1], edges[1:], strict=True):
            if j > i:
                v = acting[i]
                ran = solve_ivp(
                    lambda t, x, v=v: [x[1], a * x[1] + b * v + c * np.tanh(x[1] / 5.0) + d * np.tanh(v / 5.0)],
                    (at[i], at[j]), y, "LSODA", t_eval=at[i + 1 : j + 1], rtol=1e-6, atol=1e-6,
                )  # fmt: skip
                y = ran.y[:, -1]
                found += ran.y[0].tolist()
        return np.array(found)

    return simulate


def by_sysidentpy(record: Record) -> Simulate:
    """A NARX polynomial of the speed over the duty, orthogonal least squares; its free run is summed up to an angle."""
    model = FROLS(order_selection=True, n_info_values=8, ylag=2, xlag=2, info_criteria="aic",
                  estimator=LeastSquares(), basis_function=Polynomial(degree=2))  # fmt: skip
    model.fit(X=duties(record)[:, None], y=speed(record)[:, None])

    def simulate(other: Record) -> np.ndarray:
        w = np.asarray(model.predict(X=duties(other)[:, None], y=np.zeros((model.max_lag, 1)))).ravel()
        return begun(other).angle + np.concatenate(([0.0], np.cumsum(w[:-1]) * other.sample_time_s))

    return simulate


FITS: dict[str, tuple[str, Callable[[Record], Simulate]]] = {
    "fiohost": ("fiohost", ours),
    "scipy least_squares, our kernel": ("scipy", by_scipy),
    "lmfit, our kernel": ("lmfit", by_lmfit),
    "mujoco sysid": ("mujoco", by_mujoco),
    "pysindy": ("pysindy", by_pysindy),
    "sysidentpy FROLS": ("sysidentpy", by_sysidentpy),
}


def errors(record: Record, simulated: np.ndarray) -> tuple[float, float]:
    """Rms in degrees of the whole free run, the angle within its first count free, and of one-second windows about
    their own offset and slope.
    """
    error = record.y - simulated
    error -= np.clip(error.mean(), -0.5 * record.quantum, 0.5 * record.quantum)
    windows = []
    for a, b in zip(record.windows[:-1], record.windows[1:], strict=True):
        t = np.arange(b - a)
        windows.append(error[a:b] - np.polyval(np.polyfit(t, error[a:b], 1), t))
    return float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean(np.concatenate(windows) ** 2)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    seed = secrets.randbelow(2**31) if given.seed is None else given.seed
    train, held = measured(seed)
    # a count is read at its lower edge
    held = replace(held, y=held.y + 0.5 * held.quantum)
    print(f"seed {seed}: {STRUCTURE}, {FIT_S:g} s fitted, {HELD_S:g} s held out, a count is {train.quantum:g} deg")
    print(f"{'':34}{'s of the processor':>20}{'times ours':>12}{'held-out run deg rms':>22}{'in windows of 1 s':>19}")
    rows, own = {}, 0.0
    for name, (_, fit) in FITS.items():
        fitted: list[Simulate] = []
        span = peers.seconds(lambda fit=fit, to=fitted: to.append(fit(train)), most=5)  # type: ignore[misc]
        own = own or span
        whole, windows = errors(held, fitted[-1](held))
        print(f"{name:34}{span:20.3f}{span / own:12.1f}{whole:22.3f}{windows:19.3f}", flush=True)
        rows[name] = {"s": span, "whole_deg": whole, "windows_deg": windows}
    print(f"a count alone leaves {held.quantum / 12**0.5:.3f} deg; " + peers.versions(*[v for v, _ in FITS.values()]))
    if given.json:
        given.json.write_text(json.dumps({"seed": seed, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
