"""What the current does within a PWM period: the fit's mean of a period beside the board whose edges are resolved.

    python benchmarks/pwm.py [--page]

For a current limit, a bridge that opens between pulses, a bridge drop and a sagging supply, over the winding's L/R and
the frequency of the PWM: how far the angles of a run are apart, in percent of the way turned; and how far they would be
if the model knew no ripple. So for a bridge that coasts between slow pulses, beside a current that ceases at once.
``--page`` writes docs/pwm.md.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(ROOT / "tests"))

from pairs import DRIVE, as_model, on_board, on_host  # noqa: E402

from firmware_model.plants import Plant, make_plant  # noqa: E402

PAGE = ROOT / "docs" / "pwm.md"
LAGS_S = (1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
FREQUENCIES_HZ = (500.0, 1000.0, 2000.0, 5000.0, 20000.0)
NO_RIPPLE_HZ = 1e6
MOTOR = {
    "supply_V": 9.0, "R_ohm": 5.0, "Kt_Nm_per_A": 0.34, "Ke_Vs_per_rad": 0.45, "J_kgm2": 3e-3, "coulomb_Nm": 0.018,
}  # fmt: skip
EFFECTS = {
    "current_limit": ("a limit of 45 % of the stall current", {"limit_A": 0.81}),
    "fast_decay": ("a bridge that is open between pulses", {}),
    "bridge_voltage_drop": ("a drop of 4 % of the supply", {"drop_V": 0.36}),
    "supply_sag": (
        "a source of a fifth of the winding's resistance, no capacitor", {"source_ohm": 1.0, "smoothing": "none"},
    ),
}  # fmt: skip
COASTING_HZ = (50.0, 100.0, 200.0, 500.0, 1000.0)
COASTING_LAGS_S = (1e-5, 3e-5, 1e-4, 3e-4, 1e-3)
DUTIES_PCT = (30.0, 90.0, -60.0, 15.0, 70.0, -90.0, 45.0, 0.0)
HOLD_TICKS = 60
GOOD_PCT = 0.1

HEAD = """\
# Within a PWM period

A bridge gives the winding pulses, and the current rises and falls with them. While it neither ceases nor meets a limit
the circuit is linear and its mean over a period follows the mean voltage, however large the ripple (Middlebrook and
Cuk, A general unified approach to modelling switching-converter power stages, 1976). Elsewhere the fit follows the
current that repeats itself from period to period piece by piece (`fiohost/motor/electrics.py`): the fixed point of the
period's map, whose mean drives. Before it repeats, the mean moves as in the linear circuit until it comes there. The
frequency is `pwm_hz` of a log, a map or a model; without an inductance in the model there is no ripple, and means are
all it knows. A supply that sags is taken by its mean resistance, whatever the ripple.

Here a motor runs 2.4 s of duty steps on the [simulated board](plants.md) with its edges resolved, and in the fit. Each
field: the largest difference in percent of the way turned; in brackets the same for a fit that knows no ripple. Bold:
above {good:g} %, where the averaged form does not hold. Written by `python benchmarks/pwm.py --page`.
"""


COASTING = """
## coast_pwm: a bridge that coasts between slow pulses

School controllers switch a motor on and off a few hundred times a second and let it coast in between. With slow pulses
a fast winding's current ceases in each, and its mean over a period has a closed form: with `D` the duty, `V` the
supply, `E` the back-emf and `a` the winding's L/R as a share of the period (`decay_periods`), in percent of full duty

    i = D (V - E) - a (V + E) ln(1 + (V - E) (1 - exp(-D / a)) / (V + E))     where the current ceases
    i = (2 D - 1) V - E                                                       where it never does

so that a current that ceases at once is `D (V - E)`: the back-emf brakes by the duty's share only. Viscous friction
acts all the time, so here it shows apart from the back-emf: `viscous_friction` beside `coast_pwm`. Nothing of this
needs the frequency: a log whose bench's PWM nobody knows tells `decay_periods`. A winding that is slow beside the
period is `fast_decay` with `pwm_hz`.

In brackets: a current that ceases at once, `decay_periods = 0`. The slower the pulses, the more the shaft itself shakes
within a period, which no mean shows.
"""


def plant(effect: str, lag_s: float, pwm_hz: float) -> Plant:
    values = {"pwm_Hz": pwm_hz} if effect == "coast_pwm" else EFFECTS[effect][1]
    table = {**MOTOR, "L_H": lag_s * MOTOR["R_ohm"], "pwm_hz": pwm_hz, "effects": {effect: values}}
    return make_plant(table, "drawn")


def apart_pct(effect: str, lag_s: float, pwm_hz: float) -> tuple[float, float]:
    """Largest difference to the board in percent of the way turned: of the fit, and of one that knows no ripple."""
    motor = plant(effect, lag_s, pwm_hz)
    duties = np.repeat(DUTIES_PCT, HOLD_TICKS)
    modes = np.full(len(duties), DRIVE, dtype=np.int64)
    seen = on_board(motor, modes, duties, "edge_resolved")
    way = float(np.sum(np.abs(np.diff(seen))))
    model = as_model(motor)
    start = 180.0 / motor.counts_per_rev
    ceasing = {"coast_pwm.decay_periods": 0.0}
    plain = model.with_values(ceasing) if effect == "coast_pwm" else model.with_pwm(NO_RIPPLE_HZ)
    hosts = (on_host(m, start, modes, duties) for m in (model, plain))
    near, blind = (100.0 * float(np.max(np.abs(seen - y))) / max(way, 1.0) for y in hosts)
    return near, blind


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--page", action="store_true", help="write docs/pwm.md")
    options = parser.parse_args()
    text = HEAD.format(good=GOOD_PCT)
    for effect in (*EFFECTS, "coast_pwm"):
        coasts = effect == "coast_pwm"
        text += COASTING if coasts else f"\n## {effect}: {EFFECTS[effect][0]}\n"
        frequencies = COASTING_HZ if coasts else FREQUENCIES_HZ
        text += "\n| L/R | " + " | ".join(f"{hz:g} Hz" for hz in frequencies) + " |\n"
        text += "|---" * (len(frequencies) + 1) + "|\n"
        for lag_s in COASTING_LAGS_S if coasts else LAGS_S:
            fields = []
            for hz in frequencies:
                near, blind = apart_pct(effect, lag_s, hz)
                told = f"{near:.2g}" if near <= GOOD_PCT else f"**{near:.2g}**"
                fields.append(f"{told} ({blind:.2g})")
            text += f"| {1e3 * lag_s:g} ms | " + " | ".join(fields) + " |\n"
            print(f"{effect} {1e3 * lag_s:g} ms: {'; '.join(fields)}", flush=True)
    if options.page:
        PAGE.write_text(text, encoding="utf-8")
        print(PAGE)


if __name__ == "__main__":
    main()
