"""Where things stand in the kernel's arrays: the state of a run, and the parameters that the kernel knows by name."""

from __future__ import annotations

from fiohost.motor.effect import layout
from fiohost.motor.hooks import EFFECT_INDEX

# Angle and speed of the motor; of the load beyond a gap or spring; the side of the gap in contact (-1, 0 none, +1);
# current, in percent of stall; deflection before sliding, in degrees; warmth of winding and of bearings, 0 to 1.
THETA, OMEGA, LOAD_THETA, LOAD_OMEGA, CONTACT, CURRENT, BRISTLE, WINDING, BEARING = range(9)
STATE_SIZE = 9

# Behind the state the kernel remembers exponentials, as most steps are as long as the one before: of the mechanical lag
# (span, time constant, value), and of current and speed together (span, two time constants, two values).
STEP_DECAY, HALF_DECAY = STATE_SIZE, STATE_SIZE + 3
STEP_SWING, HALF_SWING = STATE_SIZE + 6, STATE_SIZE + 11
WORK_SIZE = STATE_SIZE + 16

BRAKE = 2
DRIVE = 1
STANDBY = 0

GAIN = layout()["linear"]
TAU = GAIN + 1

FAST_ON, FAST_LAG = EFFECT_INDEX["fast_decay"], layout()["fast_decay"]
DELAY_ON, DELAY = EFFECT_INDEX["transport_delay"], layout()["transport_delay"]
BACKLASH, GAP = EFFECT_INDEX["backlash"], layout()["backlash"]
SIDE, SHARE = GAP + 1, GAP + 2
SPRING_ON, RESONANCE = EFFECT_INDEX["shaft_compliance"], layout()["shaft_compliance"]
DAMPING, SPRING_SHARE = RESONANCE + 1, RESONANCE + 2
LAG_ON, LAG = EFFECT_INDEX["armature_inductance"], layout()["armature_inductance"]
BRISTLE_ON, BREAKAWAY = EFFECT_INDEX["presliding_friction"], layout()["presliding_friction"]
HEATING_ON, RISE = EFFECT_INDEX["armature_heating"], layout()["armature_heating"]
HEATING = RISE + 1
WARMING_ON, WARMING = EFFECT_INDEX["friction_warm_up"], layout()["friction_warm_up"] + 1
WARMING_BY = WARMING + 1
STOP_ON, STOP = EFFECT_INDEX["hard_stop"], layout()["hard_stop"]
CHANGE_ON, CHANGE_TIME = EFFECT_INDEX["parameter_change"], layout()["parameter_change"]
CHANGE_WHICH, CHANGE_RATIO = CHANGE_TIME + 1, CHANGE_TIME + 2

SMALLEST_SHARE = 0.01
SMALLEST_LAG_S = 2e-5
SMALLEST_BREAKAWAY = 1e-3
