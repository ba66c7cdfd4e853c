"""The motor behind the bridge: the kernel's arrays for one plant, and calls that let time pass."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from firmware_model.errors import FirmwareModelError
from firmware_model.hooks import HOOKS, offsets, parameter_count, state_count
from firmware_model.kernel import meters, run
from firmware_model.layout import (
    BODIES,
    COUNT,
    CURRENT,
    DIRECTION,
    EDGES,
    EVENTS,
    FLOW,
    FOLDED,
    LOAD_THETA,
    LOOKS,
    LOST_WAY,
    MEAN,
    OFF,
    OWN,
    PHASE,
    PLAIN,
    QUEUE,
    REALS,
    SLIP,
    STATES,
    STEPS,
    STIFF,
    STRIDE,
    SWITCHES,
    THETA,
    TIME,
    C,
)
from firmware_model.linear import ROW
from firmware_model.periods import WORK_ROWS
from firmware_model.plants import PWM, Plant, check_pwm
from firmware_model.registry import effects, index_of

FloatArray = npt.NDArray[np.float64]

# A winding faster than this is better described by none (L_H = 0): the integration would only creep.
FASTEST_WINDING_S = 9e-6
# Of the fastest motion in one PWM period; the steps' error in its frequency is a 24th of the square.
STIFF_RADIANS = 0.03
METER_PARTS = 40  # of a PWM period


def constants(plant: Plant) -> tuple[FloatArray, npt.NDArray[np.uint8]]:
    """The kernel's constants ``p`` and effect switches ``on`` for a plant."""
    p = np.zeros(parameter_count())
    p[C.R], p[C.L], p[C.KT], p[C.KE] = plant.R_ohm, plant.L_H, plant.Kt_Nm_per_A, plant.Ke_Vs_per_rad
    p[C.J], p[C.B], p[C.COULOMB], p[C.SUPPLY] = plant.J_kgm2, plant.B_Nms, plant.coulomb_Nm, plant.supply_V
    p[C.PERIOD] = 1.0 / plant.pwm_hz
    p[C.QUANTUM] = 2.0 * math.pi / plant.counts_per_rev
    p[C.STOP] = p[C.CHANGE_AT] = math.inf
    on = np.zeros(len(effects()), np.uint8)
    for name, effect in effects().items():
        if name not in plant.effects:
            continue
        values = plant.effects[name]
        on[index_of()[name]] = 1
        for i, parameter in enumerate(effect.parameters):
            value = values[parameter.key]
            p[offsets()[name] + i] = parameter.choices.index(value) if parameter.choices else value
        if effect.structure is not None:
            for constant, number in effect.structure(plant, values).items():
                # A spring and a gap between the same two bodies each know part of them.
                p[C[constant]] = number if constant in ("STOP", "CHANGE_AT") else max(number, p[C[constant]])
    if p[C.FAST] and p[C.L] <= 0.0:
        raise FirmwareModelError(
            f"plant {plant.name!r}: a bridge that is open between pulses (fast_decay, coast_pwm) needs a winding with "
            "inductance; give L_H or armature_inductance"
        )
    if 0.0 < p[C.L] < FASTEST_WINDING_S * p[C.R]:
        raise FirmwareModelError(
            f"plant {plant.name!r}: L_H = {p[C.L]:g} with R_ohm = {p[C.R]:g} gives an electrical time constant below "
            f"{FASTEST_WINDING_S * 1e6:g} us; write L_H = 0 for a winding without inductance"
        )
    return p, on


def is_plain(plant: Plant) -> bool:
    """Whether no effect but those on the command and on the encoder acts: the motor is linear but for its friction."""
    quiet = {"command", "measure"}
    structures = {"armature_inductance", "missed_counts", "transport_delay"}
    for name in plant.effects:
        effect = effects()[name]
        acting = {kind for kind in HOOKS if getattr(effect, kind) is not None}
        if acting - quiet or (effect.structure is not None and name not in structures):
            return False
    return True


def is_folded(plant: Plant) -> bool:
    """Whether the disc's error is so steep that its angle turns back while the shaft does not."""
    disc, shaft = plant.effects.get("encoder_eccentricity"), plant.effects.get("shaft_angle_error")
    steep = 0.0 if disc is None else disc["level_rad"] * disc["order"]
    if shaft is not None:
        steep += sum(n * shaft[f"level_{n}_rad"] for n in (1, 2, 3))
    return bool(steep >= 1.0)


def is_stiff(plant: Plant, p: FloatArray) -> bool:
    """Whether a spring or a bristle is too fast for one step in a segment of the PWM."""
    inverse = 1.0 / (plant.J_kgm2 - p[C.LOAD_J]) + (1.0 / p[C.LOAD_J] if p[C.LOAD_J] else 0.0)
    fastest = math.sqrt(p[C.STIFFNESS] * inverse) + p[C.DAMPING] * inverse
    if p[C.DEFLECTION]:
        level = plant.coulomb_Nm + sum(
            abs(float(value))
            for name, values in plant.effects.items()
            if effects()[name].friction is not None
            for key, value in values.items()
            if key.endswith("_Nm")
        )
        fastest += math.sqrt(level / p[C.DEFLECTION] * inverse)
    return bool(fastest * p[C.PERIOD] > STIFF_RADIANS)


class Motor:
    """A motor at rest at power-on; ``within_count`` and ``within_gap`` (0..1) place it in its count and its play.

    ``pwm`` ("averaged" or "edge_resolved") takes the place of the plant's own key.
    """

    def __init__(
        self, plant: Plant, *, within_count: float = 0.5, within_gap: float = 0.5, pwm: str | None = None
    ) -> None:
        p, on = constants(plant)
        resolved = plant.pwm if pwm is None else check_pwm(pwm, f"plant {plant.name!r}")
        if resolved != PWM[0] and p[C.L] <= 0.0:
            raise FirmwareModelError(
                f"plant {plant.name!r}: pwm = {resolved!r} needs a winding with inductance; give L_H or "
                "armature_inductance (a winding without any is served by 'averaged')"
            )
        y = np.zeros(state_count())
        m = np.zeros(SWITCHES, np.int64)
        r = np.zeros(REALS)
        y[THETA] = within_count * p[C.QUANTUM]
        y[LOAD_THETA] = y[THETA]
        if p[C.AFTER]:
            y[THETA] += (1.0 - 2.0 * within_gap) * p[C.HALF_GAP]
        else:
            y[LOAD_THETA] += (1.0 - 2.0 * within_gap) * p[C.HALF_GAP]
        m[BODIES] = 2 if p[C.LOAD_J] > 0.0 else 1
        m[STATES] = self._states_needed(plant, p)
        m[FLOW] = 1
        m[LOOKS] = -1
        m[PHASE] = MEAN if resolved == PWM[0] else OFF
        m[PLAIN], m[STIFF], m[FOLDED] = is_plain(plant), is_stiff(plant, p), is_folded(plant)
        r[STRIDE] = 0.001
        self._y, self._r, self._m, self._p, self._on = y, r, m, p, on
        self._own_limit = int(on[index_of()["current_limit"]]), float(p[offsets()["current_limit"]])
        self._plain = bool(m[PLAIN])
        self._command = 0, 0.0  # mode and duty latched last
        self._queue = np.zeros((3, QUEUE))
        self._work = np.zeros((WORK_ROWS, max(state_count(), ROW)))
        # Of one task step: mode, duty, and the counter and the state before it.
        self._one = np.zeros(1, np.int64), np.zeros(1), np.zeros(1, np.int64), np.zeros((1, len(y)))
        self._pass(0, 0.0, 0.0)  # compiled here, not in the first task step
        first = float(y[LOAD_THETA] if p[C.AFTER] else y[THETA])
        p[C.ANGLE_ZERO] = math.floor(measured(first, p, on) / p[C.QUANTUM])
        r[EDGES] = 0.0

    @staticmethod
    def _states_needed(plant: Plant, p: FloatArray) -> int:
        """How much of the state takes part; the rest would only cost time."""
        if any(effects()[name].states for name in plant.effects):
            return state_count()
        if p[C.DEFLECTION] > 0.0:
            return OWN
        if p[C.LOAD_J] > 0.0:
            return SLIP
        return LOAD_THETA

    def _arrays(self) -> tuple[Any, ...]:
        return self._y, self._r, self._m, self._queue, self._work, self._p, self._on

    @property
    def count(self) -> int:
        """The encoder counter, unwrapped."""
        return int(self._m[COUNT])

    @property
    def direction(self) -> int:
        """Direction of the last edge: 0 up, 1 down."""
        return int(self._m[DIRECTION])

    @property
    def time_s(self) -> float:
        """Time since power-on."""
        return float(self._r[TIME])

    @property
    def current_A(self) -> float:
        """Mean winding current now; where edges are resolved, of the period that begins."""
        return self._meters()[0]

    @property
    def voltage_V(self) -> float:
        """Mean voltage across the winding now; where edges are resolved, of the period that begins."""
        return self._meters()[1]

    def _meters(self) -> tuple[float, float]:
        """Mean current in A and voltage in V."""
        if self._m[PHASE] == MEAN:
            current, volts = meters(*self._arrays())
            return float(current), float(volts)
        copies = tuple(array.copy() for array in self._arrays())  # what is looked at goes on undisturbed
        y, p = copies[0], self._p
        theta, first, period = y[THETA], y[CURRENT], p[C.PERIOD]
        modes, duties = (np.full(METER_PARTS, value) for value in self._command)
        _, states = _stepped(copies, modes, duties, period / METER_PARTS)
        mean = (states[:, CURRENT].sum() + 0.5 * (y[CURRENT] - first)) / METER_PARTS  # by trapezia
        ramp = (p[C.L] * (y[CURRENT] - first) + p[C.KE] * (y[THETA] - theta)) / period
        return float(mean), float(p[C.R] * mean + ramp)

    def set_external_torque(self, torque_Nm: float) -> None:
        """Torque on the output shaft from outside, positive forward, from now on."""
        self._p[C.EXTERNAL] = torque_Nm

    def set_current_limit(self, limit_A: float | None) -> None:
        """A bench supply that lets no more current through, from now on; None: the plant's own limit, if it has one."""
        on, limit = self._own_limit
        k = index_of()["current_limit"]
        self._on[k], self._p[offsets()["current_limit"]] = (on, limit) if limit_A is None else (1, limit_A)
        self._m[PLAIN] = self._plain and not self._on[k]

    def reset_counter(self) -> None:
        """The encoder's timer starts anew, wherever the shaft is."""
        self._m[COUNT] = self._m[DIRECTION] = 0

    @property
    def events(self) -> tuple[int, int]:
        """Events met and steps tried so far."""
        return int(self._m[EVENTS]), int(self._m[STEPS])

    def run(self, mode: int, duty_pct: float, span_s: float) -> None:
        """Let ``span_s`` pass with the bridge in ``mode`` at a signed duty in percent."""
        self._command = mode, duty_pct
        self._pass(mode, duty_pct, span_s)

    def _pass(self, mode: int, duty_pct: float, span_s: float, parts: int = 1) -> None:
        """Let one task step pass."""
        modes, duties, counts, states = self._one
        modes[0], duties[0] = mode, duty_pct
        run(*self._arrays(), modes, duties, span_s, parts, counts, states)
        self._check()

    def _check(self) -> None:
        if self._m[LOST_WAY]:
            raise FirmwareModelError(
                "the plant cannot be integrated: its constants make it too stiff or it never settles; check them"
            )

    def run_many(
        self, modes: npt.NDArray[np.int64], duties_pct: FloatArray, span_s: float
    ) -> tuple[npt.NDArray[np.int64], FloatArray]:
        """Many task steps; counts (n,) and states (n, state size, SI units) as they were before each."""
        if len(modes):
            self._command = int(modes[-1]), float(duties_pct[-1])
        counts, states = _stepped(self._arrays(), modes, duties_pct, span_s)
        self._check()
        return counts, states


def _stepped(
    arrays: tuple[Any, ...], modes: npt.NDArray[np.int64], duties_pct: FloatArray, span_s: float
) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Task steps by a motor's arrays: counts (n,) and states (n, state size) as they were before each."""
    counts, states = np.zeros(len(duties_pct), np.int64), np.zeros((len(duties_pct), len(arrays[0])))
    run(*arrays, modes, duties_pct, span_s, 1, counts, states)
    return counts, states


def measured(angle_rad: float, p: FloatArray, on: npt.NDArray[np.uint8]) -> float:
    """The angle that the encoder's disc shows."""
    for name, effect in effects().items():
        if on[index_of()[name]] and effect.measure is not None:
            angle_rad = effect.measure(angle_rad, p, offsets()[name])
    return angle_rad
