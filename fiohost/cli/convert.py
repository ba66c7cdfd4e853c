"""``fiohost convert`` and ``fiohost tf``: the converter and the transfer functions of the control lab's window."""

from __future__ import annotations

import click

from fiohost.cli.options import parse_number
from fiohost.cli.output import json_option, output_for
from fiohost.errors import ConfigError

LARGEST = 1e30


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("value", metavar="VALUE")
@click.argument("unit", metavar="UNIT")
@click.argument("to", required=False, metavar="[TO]")
@click.option("--counts", default="720", show_default=True, metavar="N", help="Encoder counts of a turn, for count.")
@click.option("--supply", default="4.5", show_default=True, metavar="V", help="Voltage at full duty, for duty_pct.")
@click.option("--drum", default="1.375", show_default=True, metavar="CM", help="Radius of the drum, for car_cm.")
@json_option
def convert(value: str, unit: str, to: str | None, counts: str, supply: str, drum: str, json_to: str | None) -> None:
    """Convert VALUE from UNIT to another, or to those that are common for it.

    \b
    Example:
      fiohost convert 160 deg rad
      fiohost convert 7.636 rad/s
      fiohost convert 0.25 N*m/A ozf*inch/A
      fiohost convert 2.25 V duty_pct --supply 9
      fiohost convert 5 car_cm count
    """
    from fiohost.labs.units import convert as work_out

    out = output_for(json_to)
    found = work_out(
        parse_number("VALUE", value, -LARGEST, LARGEST), unit, to,
        counts_per_turn=parse_number("--counts", counts, 1.0, 1e9),
        supply_V=parse_number("--supply", supply, 0.1, 1000.0, "V"),
        drum_cm=parse_number("--drum", drum, 1e-3, 1e4, "cm"),
    )  # fmt: skip
    for other, name in found.others:
        out(f"{found.value:.10g} {found.unit} = {other:.7g} {name}")
    others = [{"value": other, "unit": name} for other, name in found.others]
    out.json({"schema": "fiohost.convert/1", "value": found.value, "unit": found.unit, "converted": others})


@click.command()
@click.option("--constants", metavar="SET|FILE", help="A motor: no_load, arm_measured, arm_tuned, elevator, or a file.")
@click.option("--output", "to", default="speed", show_default=True, metavar="OUT", help="speed, angle or current.")
@click.option("--no-winding", is_flag=True, help="Without the inductance: the second-order form.")
@click.option("--num", metavar="LIST", help="Numerator's coefficients, the highest power first.")
@click.option("--den", metavar="LIST", help="Denominator's coefficients.")
@click.option("--zeros", metavar="LIST", help="Zeros, as -2,-1+3j,-1-3j.")
@click.option("--poles", metavar="LIST", help="Poles.")
@click.option("--gain", default="1", show_default=True, metavar="K", help="Factor before zeros and poles.")
@click.option("--kp", metavar="KP", help="Close the loop with this proportional gain.")
@click.option("--frequency", metavar="RAD_S", help="Also gain and phase at this frequency.")
@json_option
def tf(
    constants: str | None, to: str, no_winding: bool, num: str | None, den: str | None, zeros: str | None,
    poles: str | None, gain: str, kp: str | None, frequency: str | None, json_to: str | None,
) -> None:  # fmt: skip
    """A transfer function in all forms: polynomials, zeros and poles, time constants, its poles and their damping.

    \b
    Example:
      fiohost tf --constants no_load
      fiohost tf --constants arm_measured --output angle --no-winding --kp 3
      fiohost tf --num 4 --den 1,2,4 --frequency 2
      fiohost tf --poles -1+2j,-1-2j --gain 5
    """
    from fiohost.labs.transfer import TransferFunction, motor_function

    out = output_for(json_to)
    ways = [constants is not None, num is not None or den is not None, zeros is not None or poles is not None]
    if sum(ways) != 1:
        raise click.UsageError("give --constants, or --num and --den, or --poles (and --zeros): one of the three")
    if constants is not None:
        from fiohost.labs.constants import MotorConstants

        found = motor_function(MotorConstants.load(constants), to, winding=not no_winding)
    elif num is not None or den is not None:
        found = TransferFunction.of(_numbers("--num", num or "1"), _numbers("--den", den or "1"))
    else:
        factor = parse_number("--gain", gain, -LARGEST, LARGEST)
        found = TransferFunction.from_roots(factor, _roots("--zeros", zeros), _roots("--poles", poles))
    if kp is not None:
        found = found.fed_back(parse_number("--kp", kp, 1e-9, 1e9))
    out(f"polynomials      {found.polynomial()}")
    out(f"zeros and poles  {found.roots()}")
    out(f"time constants   {found.time_constants()}")
    named = "gain at 0" if found.kind == 0 else f"K, with {found.kind} pole{'s' if found.kind > 1 else ''} at 0"
    out(f"{named:<16} {found.dc_gain:.5g}")
    for mode in found.modes():
        what = f"tau = {mode.tau_s:.5g} s" if mode.tau_s is not None else "integrates"
        if mode.omega_n_rad_s is not None:
            what = f"omega_n = {mode.omega_n_rad_s:.5g} rad/s, zeta = {mode.zeta:.4g}"
        out(f"pole             {mode.pole}  ({what})")
    told: dict[str, object] = {
        "schema": "fiohost.transfer_function/1", "num": list(found.num), "den": list(found.den), "type": found.kind,
        "dc_gain": found.dc_gain, "factor": found.gain,
        "poles": [[p.real, p.imag] for p in found.poles], "zeros": [[z.real, z.imag] for z in found.zeros],
        "modes": [vars(mode) for mode in found.modes()],
    }  # fmt: skip
    if frequency is not None:
        import cmath
        import math

        omega = parse_number("--frequency", frequency, 1e-9, 1e9, "rad/s")
        value = found.at(omega)
        size, phase = abs(value), math.degrees(cmath.phase(value))
        out(f"at {omega:g} rad/s     gain {size:.5g} ({20.0 * math.log10(size) if size else -math.inf:.4g} dB), "
            f"phase {phase:.4g} deg")  # fmt: skip
        told |= {"omega_rad_s": omega, "gain": size, "phase_deg": phase}
    out.json(told)


def _numbers(option: str, text: str) -> list[float]:
    """Coefficients, which may repeat."""
    return [parse_number(option, part, -LARGEST, LARGEST) for part in text.split(",")[:100]]


def _roots(option: str, text: str | None) -> list[complex]:
    found = []
    for part in (text or "").split(",")[:100] if text else []:
        try:
            value = complex(part.strip().replace("i", "j").replace(" ", ""))
        except ValueError:
            raise ConfigError(f"{option} {part[:40]!r} is no number a+bj") from None
        if not abs(value) <= LARGEST:
            raise ConfigError(f"{option} {part[:40]!r} is not finite")
        found.append(value)
    return found
