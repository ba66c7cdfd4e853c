"""Transfer functions in the forms of the control lab's window (section D-3): polynomials, roots, time constants.

A motor's come from its constants (Eqs. 7-15, 7-53, D-15), with the winding's inductance or without.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.errors import ConfigError
from fiohost.labs.constants import MotorConstants

OUTPUTS = ("speed", "angle", "current")
HIGHEST = 12  # order of a polynomial
SMALLEST = 1e-100  # of a coefficient that is not 0: roots and their squares stay numbers
SAME = 1e-9  # of the largest coefficient: less is none
NEAR_ZERO = 1e-7  # of the largest pole


@dataclass(frozen=True)
class Mode:
    """One pole or pair: real part and frequency in 1/s, with what belongs to it."""

    real: float
    imaginary: float
    tau_s: float | None
    omega_n_rad_s: float | None
    zeta: float | None

    @property
    def pole(self) -> str:
        return f"{self.real:.5g}" if self.imaginary == 0.0 else f"{self.real:.5g} +- j {self.imaginary:.5g}"


@dataclass(frozen=True)
class TransferFunction:
    """``num(s) / den(s)``, coefficients with the highest power first; :meth:`of` refuses what is no proper fraction."""

    num: tuple[float, ...]
    den: tuple[float, ...]

    @classmethod
    def of(cls, num: Sequence[float], den: Sequence[float]) -> TransferFunction:
        """Without leading zeros. Raises ConfigError."""
        for name, values in (("numerator", num), ("denominator", den)):
            if not 1 <= len(values) <= HIGHEST + 1 or not np.isfinite(values).all():
                raise ConfigError(f"the {name} has 1 to {HIGHEST + 1} finite coefficients, the highest power first")
            if any(value and abs(value) < SMALLEST for value in values):
                raise ConfigError(f"the {name} has a coefficient below {SMALLEST:g}, which no motor has")
        top, bottom = (np.trim_zeros(np.asarray(values, dtype=np.float64), "f") for values in (num, den))
        if not bottom.size or not top.size:
            raise ConfigError("a transfer function needs a numerator and a denominator that are not 0")
        if len(top) > len(bottom):
            raise ConfigError("the numerator is of higher order than the denominator: no such system can be built")
        return cls(tuple(top.tolist()), tuple(bottom.tolist()))

    @classmethod
    def from_roots(cls, gain: float, zeros: Sequence[complex], poles: Sequence[complex]) -> TransferFunction:
        """``gain prod(s - z) / prod(s - p)``. Raises ConfigError where complex roots are no pairs."""
        found = [np.poly(np.asarray(roots, dtype=np.complex128)) for roots in (zeros, poles)]
        for roots in found:
            if np.max(np.abs(np.imag(roots)), initial=0.0) > SAME * np.max(np.abs(roots)):
                raise ConfigError("complex zeros and poles come in pairs a+bj, a-bj")
        top, bottom = (np.real(np.atleast_1d(roots)) for roots in found)
        return cls.of((gain * top).tolist(), bottom.tolist())

    @property
    def poles(self) -> np.ndarray:
        return np.roots(self.den)

    @property
    def zeros(self) -> np.ndarray:
        return np.roots(self.num)

    @property
    def gain(self) -> float:
        """The factor of the form with zeros and poles."""
        return self.num[0] / self.den[0]

    @property
    def kind(self) -> int:
        """How many poles are at 0: the system's type."""
        return len(self.den) - len(np.trim_zeros(np.asarray(self.den), "b"))

    @property
    def dc_gain(self) -> float:
        """Gain at 0 of what is left without the poles at 0."""
        return self.num[-1] / self.den[-1 - self.kind]

    def at(self, omega_rad_s: float) -> complex:
        """The value at s = j omega. Raises ConfigError on a pole."""
        s = complex(0.0, omega_rad_s)
        bottom = complex(np.polyval(self.den, s))
        if bottom == 0.0:
            raise ConfigError(f"the transfer function has a pole at {omega_rad_s:g} rad/s")
        return complex(np.polyval(self.num, s)) / bottom

    def modes(self) -> list[Mode]:
        """Its poles, each pair once, the slowest first."""
        found, largest = [], float(np.max(np.abs(self.poles), initial=0.0))
        for pole in sorted(self.poles, key=lambda p: (abs(p), p.imag)):
            real, imaginary = float(pole.real), float(pole.imag)
            if abs(pole) <= NEAR_ZERO * largest or abs(pole) == 0.0:
                found.append(Mode(0.0, 0.0, None, None, None))
            elif abs(imaginary) <= NEAR_ZERO * abs(pole):
                found.append(Mode(real, 0.0, -1.0 / real, None, None))
            elif imaginary > 0.0:
                size = math.hypot(real, imaginary)
                found.append(Mode(real, imaginary, None, size, -real / size))
        return found

    def fed_back(self, gain: float = 1.0) -> TransferFunction:
        """``gain G / (1 + gain G)``."""
        top = gain * np.asarray(self.num)
        return TransferFunction.of(top.tolist(), np.polyadd(self.den, top).tolist())

    # ---- as people write them --------------------------------------------------------------------------------------

    def polynomial(self) -> str:
        return f"({_polynomial(self.num)}) / ({_polynomial(self.den)})"

    def roots(self) -> str:
        """Zeros, poles and a factor."""
        return f"{self.gain:.5g} {_product(_factors(self.zeros))}".strip() + f" / {_below(_factors(self.poles))}"

    def time_constants(self) -> str:
        """K, time constants and pairs: ``K / (s (tau s + 1) (s^2/wn^2 + 2 zeta s/wn + 1))``."""
        below = ["s"] * self.kind
        for mode in self.modes():
            if mode.tau_s is not None:
                below.append(f"({mode.tau_s:.5g} s + 1)")
            elif mode.omega_n_rad_s is not None and mode.zeta is not None:
                below.append(f"({mode.omega_n_rad_s**-2:.5g} s^2 + {2.0 * mode.zeta / mode.omega_n_rad_s:.5g} s + 1)")
        above = [f"({-1.0 / z.real:.5g} s + 1)" for z in self.zeros if abs(z.imag) == 0.0 and z.real != 0.0]
        above += ["s"] * sum(1 for z in self.zeros if z == 0.0)
        top = self.num[-1] if self.num[-1] != 0.0 else np.trim_zeros(np.asarray(self.num), "b")[-1]
        pairs = [z for z in self.zeros if z.imag > 0.0]
        above += [f"({abs(z) ** -2:.5g} s^2 + {-2.0 * z.real / abs(z) ** 2:.5g} s + 1)" for z in pairs]
        factor = float(top) / self.den[-1 - self.kind]
        return f"{_product([f'{factor:.5g}', *above])} / {_below(below)}"


def motor_function(q: MotorConstants, output: str = "speed", *, winding: bool = True) -> TransferFunction:
    """From armature voltage to speed (rad/s), angle (rad) or current (A). Raises ConfigError for another output."""
    if output not in OUTPUTS:
        from fiohost.settings import nearest

        raise ConfigError(f"unknown output {output!r}; {nearest(output, OUTPUTS)}")
    L = q.L_H if winding else 0.0
    shaft = [q.J_kgm2, q.B_Nms]
    bottom = np.polyadd(np.polymul([L, q.R_ohm], shaft), [q.Kt_Nm_per_A * q.Ke_Vs_per_rad])
    if output == "current":
        return TransferFunction.of(shaft, bottom.tolist())
    if output == "angle":
        bottom = np.polymul([1.0, 0.0], bottom)
    return TransferFunction.of([q.Kt_Nm_per_A], bottom.tolist())


def _polynomial(values: Sequence[float]) -> str:
    told = ""
    for power, value in zip(range(len(values) - 1, -1, -1), values, strict=True):
        if value == 0.0:
            continue
        size = f"{abs(value):.5g}"
        name = "" if power == 0 else "s" if power == 1 else f"s^{power}"
        term = name if name and size == "1" else f"{size} {name}".strip()
        told += f" {'-' if value < 0.0 else '+'} {term}" if told else f"{'-' if value < 0.0 else ''}{term}"
    return told or "0"


def _product(factors: Sequence[str]) -> str:
    return " ".join(factors)


def _below(factors: Sequence[str]) -> str:
    """What stands below the line: in brackets where it is a product."""
    return _product(factors) or "1" if len(factors) < 2 else f"({_product(factors)})"


def _factors(roots: np.ndarray) -> list[str]:
    """``(s + 1)``, ``(s^2 + 2 s + 5)``, one for each root or pair."""
    told = []
    largest = float(np.max(np.abs(roots), initial=0.0))
    for root in sorted(roots, key=lambda r: (abs(r), r.imag)):
        if abs(root) <= NEAR_ZERO * largest or root == 0.0:
            told.append("s")
        elif abs(root.imag) <= NEAR_ZERO * abs(root):
            told.append(f"({_polynomial([1.0, -float(root.real)])})")
        elif root.imag > 0.0:
            told.append(f"({_polynomial([1.0, -2.0 * float(root.real), float(abs(root)) ** 2])})")
    return told
