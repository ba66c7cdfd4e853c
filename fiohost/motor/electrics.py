"""The winding within a PWM period: the mean of its current once it repeats, and what its mean tends to before.

In each part of a period the bridge shows the winding a voltage ``u`` and a loss ``l`` against the current, and
``lag di/dt = u - emf - l sgn(i) - ohms i``; a current of zero rests while ``|u - emf| <= l``, one at the limit stays
there. While a pulse is on ``u`` is the supply and ``l`` what the bridge drops; in the pause a shorted bridge shows
``u = 0`` and the same drop, an open one the whole supply as a loss. While the current neither ceases nor meets its
limit the circuit is linear and its mean follows the mean voltage, whatever the ripple (Middlebrook and Cuk 1976);
elsewhere the periodic current is followed piece by piece over one period. Without lag there is no ripple: such a
winding knows means alone, but for a bridge that coasts, whose mean has a closed form of its own.

Voltages in percent of the supply, currents in percent of the stalled motor's at full duty.
"""

from __future__ import annotations

from math import copysign, exp, expm1, inf, log, log1p

from fiohost.motor.compiled import inlined, part, sign
from fiohost.motor.hooks import PERIOD, ceiling, coasts, drop, lag, opens, resistance, resists, varies, voltage
from fiohost.motor.state import DRIVE, GAIN, PULSE, SMALLEST_LAG_S, STANDBY

SUPPLY = 100.0
MOST_PIECES = 4
MOST_ROUNDS = 40
CLOSE = 1e-9
# A current is where it tends to when it is so near, beside how far it tends.
ALIKE = 1e-9
# A mean of one period is more than mean voltages promise where it is by so much: it is found to a billionth.
BEYOND = 1e-6


@part
def follow(i, push, loss, ohms, tau, most, span):  # type: ignore[no-untyped-def]
    """The current after a part of a period, its integral over it, and its derivative by the current at the beginning:
    each zero crossed changes it as the rate of the current changes there.
    """
    charge, steep, left, came = 0.0, 1.0, span, 0.0
    i = min(max(i, -most), most)
    for _ in range(MOST_PIECES):
        if left <= 0.0:
            break
        way = 1.0 if i > 0.0 else -1.0
        if i == 0.0:
            if abs(push) <= loss:
                return 0.0, charge, 0.0
            way = 1.0 if push > 0.0 else -1.0
        target = (push - way * loss) / ohms
        if came != 0.0:
            steep *= target / came
        if loss > 0.0 and target * way < 0.0:
            go = tau * log((i - target) / -target)  # it comes to zero then
            if go < left:
                charge += target * go + tau * i
                steep *= target / (target - i)
                i, left, came = 0.0, left - go, target
                continue
        fallen = exp(-left / tau)
        end = target + (i - target) * fallen
        if abs(end) > most:
            bound = copysign(most, end)
            go = tau * log((i - target) / (bound - target)) if i != bound else 0.0
            return bound, charge + target * go + tau * (i - bound) + bound * (left - go), 0.0
        return end, charge + target * left + tau * (i - end), steep * fallen
    return i, charge, steep


@inlined
def ceasing(on_volts, share, drop_pct, pause_pct, emf, ohms, lag_s, period, x, kept):  # type: ignore[no-untyped-def]
    """Mean over a period of a current that begins each pulse at zero and is back there in the pause; inf where it is
    not. What a pulse leaves of a gap is kept at ``kept``, as most pulses are as long as the one before.
    """
    tau, push = lag_s / ohms, on_volts - emf
    if abs(emf) > pause_pct:
        return inf  # it flows back in the pause
    if abs(push) <= drop_pct:
        return 0.0
    way, span = sign(push), share * period
    falls = emf * way + pause_pct
    if kept < 0:
        left = exp(-span / tau)
    else:
        if x[kept] != span or x[kept + 1] != tau:
            x[kept], x[kept + 1], x[kept + 2] = span, tau, exp(-span / tau)
        left = x[kept + 2]
    rises = abs(push) - drop_pct
    lasts = tau * log(1.0 + rises * (1.0 - left) / falls)
    if lasts > period - span:
        return inf
    return way * (rises * span - falls * lasts) / (ohms * period)


@part
def repeated(on_volts, share, drop_pct, pause_pct, emf, ohms, lag_s, most, period):  # type: ignore[no-untyped-def]
    """Mean over a period of the current that repeats itself from one to the next: the fixed point of the period's map,
    by Newton's method.

    The map never falls, and rises by less than one, so the point is one and can be bracketed.
    """
    tau = lag_s / ohms
    low, high = -most, most
    if most == inf:
        high = (abs(on_volts) + abs(emf) + pause_pct) / ohms
        low = -high
    close = -CLOSE * expm1(-period / tau)
    i, mean = 0.0, 0.0
    for _ in range(MOST_ROUNDS):
        top, first, rises = follow(i, on_volts - emf, drop_pct, ohms, tau, most, share * period)
        end, second, falls = follow(top, -emf, pause_pct, ohms, tau, most, (1.0 - share) * period)
        mean = (first + second) / period
        off = end - i
        if abs(off) <= close:  # nothing is off where it ceases in each period
            break
        if off > 0.0:
            low = i
        else:
            high = i
        i += off / (1.0 - rises * falls)
        if not low <= i <= high:
            i = 0.5 * (low + high)
    return mean


@part
def coasting(volts, emf, share, lost, ohms, most, periods):  # type: ignore[no-untyped-def]
    """Mean current of a bridge that is open between pulses, each period beginning where the last one's current ceased,
    or never does; ``periods`` is L/R of the cold winding over the period.

    With ``up = V - e - l``, ``down = V + e + l`` and ``a = periods / ohms`` it rises to ``up (1 - exp(-share / a))``,
    or to its limit, and falls from that peak for ``a ln(1 + peak / down)`` of a period. The mean is ``share up - down
    fall``: ``share up`` where the winding is fast.
    """
    way = 1.0 if volts > 0.0 else -1.0
    emf *= way
    up, down = abs(volts) - emf - lost, abs(volts) + emf + lost
    if up <= 0.0:  # faster than the supply: it brakes through the diodes all the time, if against more than the loss
        return way * max(min(up + 2.0 * lost, 0.0) / ohms, -most)
    a = periods / ohms
    rises, fall, limit = share, 1.0, most * ohms
    if down <= -limit:  # turned so fast against the pulses that it stays at its limit through the pause
        return way * most
    if limit < up:
        rises = min(share, -a * log1p(-limit / up))
    if down > 0.0:
        peak = -up * expm1(-rises / a) if a > 0.0 else up
        fall = a * log1p(peak / down)
    if fall >= 1.0 - share:  # it never ceases: its mean follows the mean voltage, unless it is limited in each period
        fall, rises = 1.0 - share, share
        if limit < up:
            begins = (limit + down) * exp(-fall / a) - down if a > 0.0 else limit
            rises = min(share, a * log((up - begins) / (up - limit)))
    return way * (rises * up - down * fall + ((share - rises) * limit if rises < share else 0.0)) / ohms


@inlined
def circuit(omega, time, duty, mode, per_gain, x, shift, kept, lag_s, losing, p, on):  # type: ignore[no-untyped-def]
    """The winding at a speed, ``losing`` what ``losses`` says of it: the settled mean of its current, whether it ceases
    or is limited in each period, the mean voltages under which a current along and against the motion's sign flows, and
    the resistance.
    """
    lost, most, opening, _, resisting, periods = losing
    ohms = resistance(1.0, (duty,), x, shift, p, on) if resisting else 1.0
    emf = omega * per_gain
    share = min(abs(duty) * 0.01, 1.0)
    on_volts, pause = 0.0, lost
    if mode == STANDBY:
        share, pause = 0.0, SUPPLY + lost
    elif share > 0.0:
        on_volts = voltage(duty, (duty, time), x, shift, p, on) / share
        if opening:
            pause += abs(on_volts)
    along = share * (on_volts - lost) - (1.0 - share) * pause
    against = share * (on_volts + lost) + (1.0 - share) * pause
    ripple = 0.0
    if lag_s == 0.0 and share > 0.0 and mode != STANDBY and periods >= 0.0:
        return coasting(on_volts, emf, share, lost, ohms, most, periods), True, along, against, ohms
    if lag_s > 0.0:
        ripple = (abs(on_volts) + pause - lost) * share * (1.0 - share) * p[PERIOD] / lag_s
    up, down = (along - emf) / ohms, (against - emf) / ohms
    if along == against or up - ripple > 0.0:
        settled = up
    elif down + ripple < 0.0:
        settled = down
    elif ripple == 0.0:
        return 0.0, True, along, against, ohms
    else:
        settled = inf
    if settled != inf and abs(settled) + ripple <= most:
        return settled, False, along, against, ohms
    if ripple == 0.0:
        return copysign(most, settled), True, along, against, ohms
    mean = ceasing(on_volts, share, lost, pause, emf, ohms, lag_s, p[PERIOD], x, kept) if most == inf else inf
    if mean == inf:
        mean = repeated(on_volts, share, lost, pause, emf, ohms, lag_s, most, p[PERIOD])
    return mean, True, along, against, ohms


@inlined
def winding_lag(p, on):  # type: ignore[no-untyped-def]
    """L/R of the cold winding, 0 where it is too fast to matter."""
    found = lag((), p, on)
    return found if found >= SMALLEST_LAG_S else 0.0


@inlined
def settled_current(omega, time, duty, x, p, on):  # type: ignore[no-untyped-def]
    """Mean current in percent of stall of a driven motor at a speed, once a lag of its own is over."""
    mean, _, _, _, _ = circuit(
        omega, time, duty, DRIVE, 1.0 / p[GAIN], x, 0, -1, winding_lag(p, on), losses(p, on), p, on
    )
    return mean


@inlined
def flows(amps, along, against):  # type: ignore[no-untyped-def]
    """Which way a current flows, or starts from zero under the mean voltages for either way (0: not at all)."""
    if amps != 0.0:
        return sign(amps)
    return 1.0 if along > 0.0 else (-1.0 if against < 0.0 else 0.0)


@inlined
def winding(omega, amps, time, duty, mode, per_gain, lag, lost, free, way, settled, x, shift, p, on):  # type: ignore[no-untyped-def]
    """The current that drives, the voltage and resistance that it follows, the settled value at which it stays (inf:
    none), the way in which it flows, and whether it flows free (1) or is settled (0, or 2 where it ceases or is limited
    in each period). ``free`` is -1 at the beginning of a step; in its middle ``free`` and ``way`` are as there.
    """
    mean, special, along, against, ohms = circuit(omega, time, duty, mode, per_gain, x, shift, PULSE, lag, lost, p, on)
    if free < 0:
        free = 0
        if lag > 0.0 and not (settled and special):
            free = 1
            if special:  # it ceases or is limited in each period, and is free until it comes there
                way = flows(amps, along - omega * per_gain, against - omega * per_gain)
                tends = (along if way > 0.0 else against) - omega * per_gain - ohms * amps
                # One that ceases in each period rises at once to its mean, which is more than mean voltages promise.
                less = abs(tends) < (1.0 - BEYOND) * ohms * abs(mean - amps)
                rises = less and amps * mean >= 0.0 and abs(amps) < abs(mean)
                free = 1 if way != 0.0 and not rises and (mean - amps) * tends > ALIKE * abs(tends) else 0
    if free != 1:
        return mean, (mean + omega * per_gain if mode != STANDBY else 0.0), ohms, inf, 0.0, 2 if special else 0
    if way == 0.0:
        way = flows(amps, along - omega * per_gain, against - omega * per_gain)
    return amps, (along if way > 0.0 else against), ohms, (mean if special else inf), way, 1


@inlined
def losses(p, on):  # type: ignore[no-untyped-def]
    """Of a winding, asked once a run: voltage lost, greatest current, whether the bridge opens between pulses, whether
    voltage or resistance are other than those of a cold winding on a firm supply, and L/R over the period of a bridge
    that coasts (below 0: none).
    """
    return drop((), p, on), ceiling((), p, on), opens(on), varies(on), resists(on), coasts((), p, on)


@inlined
def is_simple(lag_s, lost, modes, acts, until):  # type: ignore[no-untyped-def]
    """Whether ``simple_winding`` is right: no current lags, or one that lags neither ceases nor is limited while modes
    act that begin at ``acts``.
    """
    if lag_s == 0.0:
        return True
    if lost[0] > 0.0 or lost[1] < inf or lost[2] or modes[0] == STANDBY:
        return False
    for k in range(acts.shape[0]):
        if acts[k] > until:
            break
        if modes[k + 1] == STANDBY:
            return False
    return True


@inlined
def simple_winding(omega, amps, time, duty, mode, per_gain, lag, lost, x, shift, p, on):  # type: ignore[no-untyped-def]
    """As ``winding``, where a mean is all there is to know: the current that drives, the voltage and resistance that it
    follows, and whether it flows free.
    """
    drop_pct, most, opening, varying, resisting, periods = lost
    if mode == STANDBY:
        return 0.0, 0.0, 1.0, 0
    volts, ohms, emf = duty, 1.0, omega * per_gain
    if varying:
        volts = voltage(duty, (duty, time), x, shift, p, on)
    if resisting:
        ohms = resistance(1.0, (duty,), x, shift, p, on)
    if lag > 0.0:
        return amps, volts, ohms, 1
    pulse = min(abs(duty) * 0.01, 1.0)
    if periods >= 0.0 and pulse > 0.0:
        push = coasting(volts / pulse, emf, pulse, drop_pct, ohms, most, periods)
        return push, push + emf, ohms, 0
    push = volts - emf
    if opening or drop_pct > 0.0:
        width = drop_pct
        if opening and pulse > 0.0:
            width += abs(volts) * (1.0 - pulse) / pulse
        push = copysign(max(abs(push) - width, 0.0), push)
    if resisting:
        push /= ohms
    push = min(max(push, -most), most)
    return push, push + emf, ohms, 0


@inlined
def loses(mode, p, on):  # type: ignore[no-untyped-def]
    """Whether a voltage is lost against the current in some part of a period, so that its zero matters."""
    return mode == STANDBY or opens(on) or drop((), p, on) > 0.0
