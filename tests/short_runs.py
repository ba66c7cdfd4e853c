"""Short experiments for tests that need logs of a board and not the whole suite."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from fiohost.bench.connect import connect
from fiohost.bench.experiment import ControlSettings, Experiment
from fiohost.bench.log import Log
from fiohost.bench.signals import Multisine, Pulses, RandomSteps, Square, Staircase


def staircase(step_s: float = 1.0) -> Experiment:
    levels = (8.0, 30.0, 80.0, 15.0, 0.0, -8.0, -30.0, -80.0, -15.0, 0.0)
    return Experiment("short_staircase", (Staircase(duration_s=len(levels) * step_s, levels=levels, step_s=step_s),))


def multisine(seconds: float = 10.0, seed: int = 3) -> Experiment:
    tones = Multisine(duration_s=seconds, amplitude=70.0, period_s=10.0, low_hz=0.1, high_hz=6.0, count=12, seed=seed)
    return Experiment(f"short_multisine_{seed}", (tones,))


def random_steps(seconds: float = 10.0, seed: int = 5) -> Experiment:
    steps = RandomSteps(duration_s=seconds, low=-80.0, high=80.0, hold_min_s=0.1, hold_max_s=0.9, seed=seed)
    return Experiment(f"short_random_steps_{seed}", (steps,))


def pulses() -> Experiment:
    """Pulses that end in brake, then in standby."""
    both = [
        Pulses(duration_s=4.5, levels=(40.0, -40.0, 90.0), on_s=0.6, off_s=0.9, rest=rest)
        for rest in ("brake", "standby")
    ]
    return Experiment("short_pulses", tuple(both))


def closed_loop(seconds: float = 10.0) -> Experiment:
    """P control of a square wave of 20 degrees, the deadband compensated: the command follows the counts."""
    control = ControlSettings("p", 1.0, u_plus_pct=3.0, u_minus_pct=-3.0)
    square = Square(duration_s=seconds, low=170.0, high=190.0, period_s=4.0)
    return Experiment("short_closed_loop", reference=(square,), control=control)


SUITE = (staircase(), multisine(seed=3), random_steps(seed=5), pulses())


def logs_of(
    target: str,
    folder: Path,
    experiments: Sequence[Experiment] = SUITE,
    *,
    seed: int | None = None,
    metadata: Mapping[str, str] | None = None,
) -> list[Log]:
    """Logs of a simulated board, one file each in ``folder``, named by their experiments."""
    with connect(target, seed=seed) as bench:
        return [bench.run(e, folder / f"{e.name}.csv", extra_metadata=metadata) for e in experiments]


def plant_file(
    folder: Path,
    changes: Mapping[str, float] | None = None,
    effects: Mapping[str, Mapping[str, float | str]] | None = None,
) -> Path:
    """A plant file made from the constants of ``ideal``, some of them changed, with effects in SI units."""
    values: dict[str, float] = {
        "supply_V": 9.0,
        "R_ohm": 5.5,
        "Kt_Nm_per_A": 0.34,
        "Ke_Vs_per_rad": 0.487,
        "J_kgm2": 3.0e-3,
        "coulomb_Nm": 0.02,
    }
    lines = ['schema = "firmware_model.plant/1"', *(f"{k} = {v!r}" for k, v in {**values, **(changes or {})}.items())]
    for effect, parameters in (effects or {}).items():
        lines.append(f"[effects.{effect}]")
        lines += [f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v!r}" for k, v in parameters.items()]
    path = folder / "plant.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def _between(rng: random.Random, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


# Six kinds of effect at sizes that show, torques in N m against a stall torque of about 0.5.
KINDS: Mapping[str, Callable[[random.Random], dict[str, float | str]]] = {
    "backlash": lambda r: {"gap_deg": _between(r, 1.0, 6.0), "side": "encoder_after_gap"},
    "constant_load": lambda r: {"torque_Nm": r.choice((-1.0, 1.0)) * _between(r, 0.003, 0.03)},
    "gravity_load": lambda r: {"torque_Nm": _between(r, 0.006, 0.04), "phase_deg": r.uniform(0.0, 360.0)},
    "input_deadband": lambda r: {"level_pct": _between(r, 1.5, 12.0)},
    "transport_delay": lambda r: {"delay_s": _between(r, 0.004, 0.045)},
    "voltage_saturation": lambda r: {"limit_pct": r.uniform(35.0, 75.0)},
}


def one_effect_plant(folder: Path, kind: str, seed: int) -> Path:
    """A plant file with one effect of a kind at a size drawn by the seed, on a motor drawn too."""
    rng = random.Random(f"{kind} {seed}")
    motor = {"J_kgm2": _between(rng, 1.7e-3, 6e-3), "coulomb_Nm": _between(rng, 0.006, 0.03)}
    return plant_file(folder, motor, {kind: KINDS[kind](rng)})
