"""Where the kernel's numbers lie: the continuous state, the switches, the clockwork and the constants."""

from __future__ import annotations

from enum import IntEnum

# y: the continuous state (rad, rad/s, A; presliding deflection in rad), then the effects' own states.
THETA, OMEGA, CURRENT, LOAD_THETA, LOAD_OMEGA, SLIP, OWN = range(7)

# m: whole numbers. SIDE is the direction of sliding (0 held), CONTACT the gap's closed face, FLOW the direction of
# current where that matters (0: blocked, 2: ceasing within each pulse), STOPPED 1 while resting on an end of travel.
SIDE, LOAD_SIDE, CONTACT, FLOW, STOPPED, MODE, BODIES, STATES = range(8)
COUNT, DIRECTION, HEAD, WAITING, EVENTS, STEPS, LOST_WAY = range(8, 15)
# PHASE is the part of the PWM period: its mean, or where edges are resolved, on or off. PLAIN is 1 where no effect acts
# on the motor's physics, STIFF 1 where a segment is too long for one step, FOLDED 1 where the disc's angle turns back
# in a motion that does not.
PHASE, PLAIN, STIFF, FOLDED = range(15, 19)
# The decoder: LEVELS of the encoder as it saw them last, INVALID changes. LOOKS counts looks at the disc that were kept
# behind the other reals, -1 where none are.
LEVELS, INVALID, LOOKS = range(19, 22)
SWITCHES = 22
MEAN, ON, OFF = range(3)

# r: reals of the clockwork.
TIME, DUTY, STRIDE, LOST, EDGES = range(5)
REALS = 8

# Commands on their way through a transport delay: rows time, duty, mode.
QUEUE = 512


class C(IntEnum):
    """Constants in p before the effects' parameters; those of the structure are set by the effects that have one."""

    R = 0
    L = 1
    KT = 2
    KE = 3
    J = 4
    B = 5
    COULOMB = 6
    SUPPLY = 7
    QUANTUM = 8
    LOAD_J = 9
    LOAD_COULOMB = 10
    HALF_GAP = 11
    AFTER = 12  # 1: the encoder sits beyond the gap or spring
    DELAY = 13
    STIFFNESS = 14
    DAMPING = 15
    STOP = 16  # angle of an end of travel, inf for none; its side is its sign
    DEFLECTION = 17  # presliding, 0 for none
    CHANGE_AT = 18  # the time of a sudden change, inf for none
    EXTERNAL = 19  # torque of the lab's furniture on the shaft
    ANGLE_ZERO = 20  # the encoder's count at power-on
    FAST = 21  # 1: bridge open between the pulses
    DIODE = 22  # volts lost in each pair of diodes that carries the current then
    SHARE_LOST = 23
    CHANGED = 24  # 1 once CHANGE_AT has passed; the kernel sets it
    PERIOD = 25  # of the PWM, s


FIRST_EFFECT = 26
