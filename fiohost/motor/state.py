"""Where things stand in the kernel's array: the state of a run, what it keeps at hand, and places others look for."""

from __future__ import annotations

from fiohost.motor.effect import effects, layout
from fiohost.motor.hooks import EFFECT_INDEX, FIXED_STATES, OWN

# Angle and speed of the motor; of the load beyond a gap or spring; the side of the gap that is closed (-1, 0 none, +1);
# mean current, in percent of stall; 1 while that is the settled one of a PWM period in which it ceases or is limited.
THETA, OMEGA, LOAD_THETA, LOAD_OMEGA, CONTACT, CURRENT, HELD = range(FIXED_STATES)
STATE_SIZE = FIXED_STATES + len(OWN)
# States that say how warm something is, 0 to 1.
WARMTH = [slot for name, slot in OWN.items() if effects()[name].warms]

# States of a sensor that follow the speed of the motor.
FOLLOWING = tuple(slot for name, slot in OWN.items() if effects()[name].measure_speed is not None)

# Behind the state: the effects' own at the middle of a step, then exponentials, as most steps are as long as the one
# before: those of a whole step, of half a step, and of a part.
MIDDLE = len(OWN)
ONE_BODY, TWO_BODIES = 8, 53
WHOLE = STATE_SIZE + MIDDLE
HALF, PART = WHOLE + ONE_BODY + TWO_BODIES, WHOLE + 2 * (ONE_BODY + TWO_BODIES)
SCRATCH = WHOLE + 3 * (ONE_BODY + TWO_BODIES)
PULSE = SCRATCH + 6 * 16  # length of a pulse, time constant, and what the one leaves of the other
WORK_SIZE = PULSE + 3

BRAKE = 2
DRIVE = 1
STANDBY = 0

GAIN = layout()["linear"]
TAU = GAIN + 1
BACKLASH, GAP = EFFECT_INDEX["backlash"], layout()["backlash"]
SHARE = GAP + 2
STOP_ON, STOP = EFFECT_INDEX["hard_stop"], layout()["hard_stop"]

SMALLEST_SHARE = 0.01
SMALLEST_LAG_S = 9e-6
# Steps in one span at the most; usual are one to ten.
MOST_STEPS = 400
