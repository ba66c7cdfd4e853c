"""An end of travel: the shaft (the load, where there are two bodies) runs onto it and stays."""

import math

from firmware_model.effect import Effect, Parameter

EFFECT = Effect(
    name="hard_stop",
    summary="an end of travel on the positive or the negative side of the start",
    equation="inelastic, rigid stop at the angle; its side is its sign",
    parameters=(Parameter("angle_rad"),),
    source="Rigid impact, no rebound",
    reduced=lambda plant, q: {"angle_deg": math.degrees(q["angle_rad"])},
    structure=lambda plant, q: {"STOP": q["angle_rad"]},
)
